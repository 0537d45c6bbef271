"""Figures: of one trial (`trial`), of a sweep (`sweep`), of cities and rays."""
