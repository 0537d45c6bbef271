"""FastSLAM: `fastslam` has its equations, `parts` what can be replaced; `paper_fastslam` is the filter of the paper."""
