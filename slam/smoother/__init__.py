"""The smoother: one batch factor graph over the whole drive."""
