"""BP-SLAM: belief propagation over associations, on the joint Gaussian of EKF-SLAM."""
