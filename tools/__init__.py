"""Instruments of the makers of cellslam, run in a checkout: python -m tools NAME. They are not installed."""
