"""The figures of a sweep: distributions, curves, consistency, cost."""
