"""Estimators: they see the observable part of a recording, never the truth."""
