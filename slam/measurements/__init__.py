"""What estimators assume of measurements: noise, detection, clutter, errors that persist, and how links are fused.

`measurement_options` has the options with their defaults, and how VTs come and go; `fusion` the links of a site fused;
`readings` the variances; `misfit` and `attitude` what is learnt while driving.
"""
