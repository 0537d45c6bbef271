"""LTE: reference signals, error bounds, the statistical path detector and their configuration."""

from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.lte.reference_signals import ReferenceSignal, reference_signal

__all__ = ["RadioConfig", "ReferenceSignal", "reference_signal"]
