"""What estimators assume of measurements: noise, detection, clutter, errors that persist, and how links are fused.

`measurement_options` has the options with their defaults; `measurement_noise` and `readings` the variances;
`visibility` the coming and going of virtual transmitters; `fusion` the links of a site fused; `misfit` and `attitude`
what is learnt while driving.
"""
