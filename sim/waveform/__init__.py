"""What a front end must know of a downlink waveform, and what LTE and NR share.

`waveform.Waveform` is the protocol, `checked` says what is wrong with one; `pseudo_random` is both's Gold sequence.
"""

from cellslam.sim.waveform.waveform import ReferenceSignal, Waveform

__all__ = ["ReferenceSignal", "Waveform"]
