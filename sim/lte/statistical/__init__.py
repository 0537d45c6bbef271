"""The statistical front end: traced paths in, measurements out, drawn from the signal level's statistics.

`statistical_front_end.detect` is the door; snapshots are drawn in `detection_kernel.measure_block`. Where to look:

- detection probability: `measurement_kernel.detection_probability`; of an isolated path it is the table that
  `statistical_front_end.detection_table` makes; what overlap leaves of a path, `detection_kernel._overlap`
- received powers: `budget_kernel`; clutter: `clutter_kernel`
- errors: `measurement_kernel.write_std` (bound and floors), `persisting_errors` (what is not white)
- constants: `statistics.json` (LTE) and a file for each band of NR, read by `statistics`, measured by
  `tools/calibration`
"""
