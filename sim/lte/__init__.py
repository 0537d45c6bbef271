"""LTE: reference signals, error bounds, the statistical path detector and their configuration."""

from cellslam.sim.lte.config import RadioConfig
from cellslam.sim.lte.reference import ReferenceSignal, reference_signal

__all__ = ["RadioConfig", "ReferenceSignal", "reference_signal"]
