"""How `statistics.json` is measured: the statistical front end fitted to, and checked against, the signal level."""
