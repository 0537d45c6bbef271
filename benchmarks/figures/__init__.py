"""Figures: of one trial, of a sweep, of cities and rays."""
