"""The statistical front end: traced paths in, measurements out, drawn from the signal level's statistics.

`statistical_front_end.detect` is the door. `detection_kernel` begins with the equations and says where each stands;
`statistics` reads the constants, measured by `tools/calibration`; `persisting_errors` draws what is not white.
"""
