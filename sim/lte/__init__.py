"""LTE: reference signals, error bounds, the statistical path detector and their configuration."""

from cellslam.sim.lte.config import RadioConfig

__all__ = ["RadioConfig"]
