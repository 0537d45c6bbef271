"""Positioning reference signals of 5G NR: which elements carry what, and in which slots.

`positioning_reference_signal` is one slot of a resource, `prs_slots` when it is sent.
"""

from cellslam.sim.nr.prs import positioning_reference_signal, prs_slots
from cellslam.sim.waveform import ReferenceSignal

__all__ = ["ReferenceSignal", "positioning_reference_signal", "prs_slots"]
