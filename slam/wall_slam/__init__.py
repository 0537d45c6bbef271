"""WALL-SLAM: the joint filter of EKF-SLAM that knows that one wall makes VTs of several sites.

`wall_slam` has the estimator, `images` which VT is the site and which are its images in walls, `joining` when two of
them are of one wall and what that teaches the filter, `facades` what is kept over a drive and reported.
"""
