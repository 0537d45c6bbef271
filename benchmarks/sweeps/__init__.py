"""Sweeps: many trials in worker processes, kept in one store that can be resumed. `sweeping` is the place to begin."""
