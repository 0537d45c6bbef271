"""Sweeps: many trials in worker processes, kept in one store that can be resumed."""
