"""The joint EKF: one covariance over vehicle, VTs and errors that persist; association nearest, or belief.

`ekf_slam` has the filter and its equations, `bp_slam` the one whose association is belief propagation, `wall_slam` the
one that knows walls (`wall_images`). `start` is a Gaussian sum over clock offsets, `mixture` filters side by side,
which `new_filters` makes; `snapshot/` the compiled recursion, `state/` what stands where in the arrays, `map_*` maps
between drives, `sizes` what a drive says of its noise.
"""
