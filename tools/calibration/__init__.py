"""How `statistics.json` is measured: the statistical front end fitted to, and checked against, the signal level.

`study.calibrate` measures random `scenes` and returns the constants; `front_end_check.agreement` compares the two front
ends in scenes of its own.
"""
