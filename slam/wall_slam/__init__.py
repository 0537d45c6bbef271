"""WALL-SLAM: the joint filter of EKF-SLAM that knows that one wall makes VTs of several sites.

`wall_slam` has the estimator, `images` which VT is the site and which are its images in walls, `joining` which of them
are in one wall, `doubles` which are in two, one after the other, `constraints` how likely that is and what it teaches
the filter, `facades` what is kept over a drive and reported.
"""
