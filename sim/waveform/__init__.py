"""What a front end must know of a downlink waveform, and what LTE and NR share.

`Waveform` is the protocol, `conformance.checked` says what is wrong with one; `pseudo_random` is both's Gold sequence.
"""

from cellslam.sim.waveform.waveform import ReferenceSignal, Waveform

__all__ = ["ReferenceSignal", "Waveform"]
