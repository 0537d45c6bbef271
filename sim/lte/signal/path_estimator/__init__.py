"""The path estimator of one link: samples of the array in, delays, angles and weights of the paths out."""
