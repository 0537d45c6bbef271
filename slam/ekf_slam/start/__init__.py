"""The start of EKF-SLAM: a Gaussian sum over the unknown clock offsets, a bank of filters a site."""
