"""Scenarios: a world, and the options of the estimators that meet it."""
