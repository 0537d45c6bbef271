"""The path estimator of one link: samples (ports, tones) in, distances, directions, SNR and covariances of paths out.

`path_estimator.estimate_paths` is the door, and its module begins with the equations. `cancellation` takes a colliding
cell out beforehand; `spectrum` is what is searched; `joint_fit` fits paths; `*_kernel` are the compiled parts of the
search and the fits.
"""
