"""What every estimator, and the bound, needs once: the measurement model h with its Jacobians, small matrices,
assignment, resampling, moments of weighted poses.
"""
