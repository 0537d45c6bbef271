"""The extended FastSLAM. `reference` is the algorithm in plain NumPy, `fastslam` the compiled one."""
