"""cellslam: simulation and evaluation of cellular multipath SLAM."""
