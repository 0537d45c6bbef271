"""Sweeps: many trials in worker processes, kept in one store that can be resumed. Begin with `sweeping`, which
says what stands where."""
