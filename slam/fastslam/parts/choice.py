"""From options, which name the parts of the filter, to the parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cellslam.sim.recording import Floats, Ints, Sites
from cellslam.slam.api import Setup, Snapshot
from cellslam.slam.fastslam.fastslam_options import FastSlamOptions
from cellslam.slam.fastslam.parts.association import Hungarian
from cellslam.slam.fastslam.parts.clock import Constant, Drifting
from cellslam.slam.fastslam.parts.criterion import Likelihood, Mahalanobis
from cellslam.slam.fastslam.parts.part_types import Parts
from cellslam.slam.fastslam.state.layout import RECORD, RECORD_WITH_RATE
from cellslam.slam.model.resampling import SCHEMES

_CRITERIA: dict[str, Any] = {"likelihood": Likelihood(), "mahalanobis": Mahalanobis()}


@dataclass(frozen=True)
class Choice:
    """The parts in use. `component_m`: width of one particle's clock offset at the start; `known_clock`: the mean of
    the prior is taken for it."""

    parts: Parts
    resampling: Callable[[Floats, int, np.random.Generator], Ints]
    component_m: float
    known_clock: bool

    @property
    def record(self) -> int:
        """Rows of a track."""
        return RECORD_WITH_RATE if isinstance(self.parts.clock, Drifting) else RECORD

    def prior(self, setup: Setup) -> Setup:
        """Return the setup as this choice takes it: a clock of one's own knows no rates."""
        sites = setup.sites
        if self.known_clock:
            sites = replace(sites, clock_offset_std_m=np.zeros_like(sites.clock_offset_std_m))
        if not isinstance(self.parts.clock, Constant):
            sites = replace(sites, clock_drift_std_m_s=None)
        return replace(setup, sites=sites)

    def for_clocks(self, sites: Sites) -> Choice:
        """Return the choice for the clocks of such a setup, which may drift."""
        if not (sites.drift_std_m_s > 0.0).any():
            return self
        return replace(self, parts=self.parts._replace(clock=Drifting(0.0, len(sites))))

    def parts_for(self, snapshot: Snapshot, born: int, elapsed_s: float) -> Parts:
        """Return the parts for one snapshot, so long after the start, `born` measurements having gone before: a part
        may ask to see it."""
        parts = self.parts
        for_snapshot = getattr(parts.association, "for_snapshot", None)
        if for_snapshot is not None:
            parts = parts._replace(association=for_snapshot(snapshot, born))
        if isinstance(parts.clock, Drifting):
            parts = parts._replace(clock=parts.clock._replace(elapsed_s=elapsed_s))
        return parts


def chosen(options: FastSlamOptions, **given: Any) -> Choice:
    """Return the parts that the options name, with objects that are `given` in their place."""
    o = options
    unknown = set(given) - {"association", "criterion", "clock", "resampling"}
    if unknown:
        raise TypeError(f"FastSlam has no part {', '.join(map(repr, sorted(unknown)))}")
    parts = Parts(
        association=given.get("association", Hungarian()),
        criterion=given.get("criterion", _CRITERIA[o.criterion]),
        clock=given.get("clock", Constant()),
    )
    return Choice(
        parts,
        given.get("resampling", SCHEMES[o.resampling]),
        component_m=0.0 if o.clock == "sampled" else o.offset_component_std_m,
        known_clock=o.clock == "known",
    )
