"""The statistical front end: traced paths in, measurements out, drawn from the signal level's statistics.

`statistics.json` holds the constants; `detection_kernel` decides which path is detected.
"""
