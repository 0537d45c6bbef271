"""FastSLAM: `fastslam`, and the filter as the paper prints it: `paper_fastslam`."""
