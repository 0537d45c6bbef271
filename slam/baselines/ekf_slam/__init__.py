"""EKF-SLAM with a joint covariance of pose, odometry errors, clock offsets and VTs."""
