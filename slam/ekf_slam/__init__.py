"""EKF-SLAM: one Gaussian over pose, odometry errors, clock offsets and virtual transmitters."""
