"""What a front end must know of a downlink waveform, and what LTE and NR share: `Waveform`, the Gold sequence."""

from cellslam.sim.waveform.waveform import ReferenceSignal, Waveform

__all__ = ["ReferenceSignal", "Waveform"]
