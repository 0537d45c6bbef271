"""One trial: a world, its bound, and every estimator driven over it and scored.

`run`, `replay`, `sweep` and the suites all score a trial here.
"""
