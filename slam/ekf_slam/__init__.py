"""Filters with one joint covariance: EKF-SLAM, and what its oracles and BP-SLAM share with it.

`ekf_slam` has the filter, `start` its Gaussian sum over clock offsets, `mixture` filters side by side, `sizes` what a
drive says of its noise.
"""
