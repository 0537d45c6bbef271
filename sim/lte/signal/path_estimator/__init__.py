"""The path estimator of one link: samples (ports, tones) in, distances, directions, SNR and covariances of paths out.

`path_estimator.estimate_paths` is the door, and its module begins with the equations; `thresholds` has all numbers that
decide. `cancellation` takes a colliding cell out beforehand; `spectrum` is what is searched, by `search_kernel`;
`fit_kernel` fits paths; `acquire_kernel` decides which of them are taken, and stay.
"""
