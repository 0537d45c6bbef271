"""Noise, detection and clutter as a recording itself shows them."""
