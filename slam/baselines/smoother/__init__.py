"""Smoother: a batch factor graph over the whole drive, with the associations of FastSLAM."""
