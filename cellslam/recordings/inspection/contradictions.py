"""Which correction of a recording, if any, makes its tables agree: the evidence behind `suspicions`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from cellslam.benchmarks.scores.reference_fixes import usable
from cellslam.recordings.inspection.corrections import Correction, Drive
from cellslam.recordings.inspection.explanations import EXPLANATIONS, Explanation
from cellslam.recordings.inspection.path_evidence import PathEvidence
from cellslam.recordings.inspection.range_evidence import RangeEvidence
from cellslam.recordings.inspection.reference_evidence import ReferenceEvidence
from cellslam.sim.recording import Floats, Ints, Recording

ROUNDS = 5  # of refinement
FEWEST, LEFT = 6, 0.75  # blocks, and share of the stretches, that a delay must leave within the drive
OVERLAP = 0.5  # stretches overlap: so much of their number is independent
MOST = 5.0  # log-likelihood that a single stretch may give or take
NATS, AGREED = 10.0, 0.7  # least gain of all stretches, and how far blocks must agree
WORTHY = 0.5  # gain of a stretch that counts as much as any
AS_WELL, NEARLY = 0.9, 0.8  # shares of another's gain


class Evidence(Protocol):
    """Two tables against each other: what a correction does to the likelihood of each stretch."""

    @property
    def name(self) -> str:
        """Of the two tables."""
        ...

    @property
    def block(self) -> Ints:
        """Blocks (n,) of the drive that the stretches belong to: their errors are independent."""
        ...

    def seen(self, c: Correction) -> Correction:
        """Return what a correction comes to between the two."""
        ...

    def change(self, c: Correction) -> Floats:
        """Return by how much the log-likelihood (n,) of each stretch grows; NaN where a delay leaves the drive."""
        ...


class Gain(NamedTuple):
    """What a correction gains: log-likelihood of a stretch, and of all (each limited).

    `agreed`: what blocks of the drive gain less what others lose, as a share of both.
    """

    mean: float = 0.0
    nats: float = 0.0
    agreed: float = 0.0


@dataclass(frozen=True)
class Contradiction:
    """A correction that makes tables agree; `gains`: by evidence."""

    explanation: Explanation
    correction: Correction
    gains: dict[str, Gain]
    total: float


def evidence_of(recording: Recording) -> list[Evidence]:
    """Return the comparisons that a recording allows."""
    fixes = fixes_of(recording)
    with_odometry = len(recording.time_s) > 2 and not np.isnan(recording.odometry[:, 0]).all()
    drive = Drive(recording)
    makers: list[Callable[[], Evidence]] = []
    if with_odometry:
        makers.append(lambda: PathEvidence(recording, drive))
        if fixes is not None:
            known = fixes
            makers.append(lambda: ReferenceEvidence(drive, *known))
    if np.isnan(recording.measurements.azimuth_rad).all():
        makers += [lambda: RangeEvidence(recording, drive, None)] if with_odometry else []
        makers += [lambda: RangeEvidence(recording, drive, fixes)] if fixes is not None else []
    found = []
    for make in makers:
        try:
            found.append(make())
        except ValueError:  # too little of it
            continue
    return found


def fixes_of(recording: Recording) -> tuple[Floats, Floats] | None:
    """Return times (R,) in s and places (R, 2) in m where the vehicle is known to have been, within the drive."""
    r = recording.reference
    if r is not None:
        rows = usable(recording, r)
        return (r.time_s[rows], r.position_m[rows, :2]) if rows.sum() > 2 else None
    return None if recording.truth is None else (recording.time_s, recording.truth.poses[:, :2])


def contradictions(recording: Recording) -> list[Contradiction]:
    """Return the correction that explains the tables best, and others that do so as well; none for sound data.

    It must gain surely in some evidence, and more there than what is nobody's mistake does.
    """
    found = ranked(evidence_of(recording))
    small = [x for x in found if x.explanation.harmless(x.correction)]
    grave = [x for x in found if not x.explanation.harmless(x.correction) and any(_sure(x, e) for e in x.gains)]
    grave = [x for x in grave if any(_sure(x, e) and not _explained(small, x, e) for e in x.gains)]
    best = sorted(grave, key=lambda x: (x.total < AS_WELL * grave[0].total, x.explanation.refined is not None))
    return [
        x
        for i, x in enumerate(best)
        if i == 0 or (x.total > AS_WELL * grave[0].total and x.explanation.refined is None)
    ]


def _sure(x: Contradiction, evidence: str) -> bool:
    gain = x.gains[evidence]
    return gain.mean > x.explanation.least and gain.nats > NATS and gain.agreed > AGREED


def _explained(others: list[Contradiction], x: Contradiction, evidence: str) -> bool:
    return any(o.gains[evidence].mean > NEARLY * x.gains[evidence].mean for o in others)


def ranked(evidence: list[Evidence]) -> list[Contradiction]:
    """Return the best correction of every explanation, by how much of what there is to explain it explains."""
    gain = [_cached(e) for e in evidence]

    def gains_of(c: Correction) -> list[Gain]:
        return [one(c) for one in gain]

    tried = []
    for explanation in EXPLANATIONS:
        best = max(((c, gains_of(c)) for c in explanation.corrections), key=lambda pair: _sum(pair[1]))
        for k in range(ROUNDS):
            near = [(c, gains_of(c)) for c in explanation.near(best[0], k)]
            best = max([best, *near], key=lambda pair: _sum(pair[1]))
        tried.append((explanation, *best))
    most = [max(WORTHY, *(gains[i].mean for _, _, gains in tried)) for i in range(len(evidence))]
    out = []
    for explanation, c, gains in tried:
        total = sum(float(np.clip(g.mean / m, -1.0, 1.0)) for g, m in zip(gains, most, strict=True))
        out.append(Contradiction(explanation, c, {e.name: g for e, g in zip(evidence, gains, strict=True)}, total))
    return sorted(out, key=lambda x: -x.total)


def _cached(evidence: Evidence) -> Callable[[Correction], Gain]:
    """Return what a correction gains in some evidence, worked out once for all that come to the same there."""
    known = {Correction(): Gain()}

    def gain(c: Correction) -> Gain:
        seen = evidence.seen(c)
        if seen not in known:
            known[seen] = _gain(evidence.change(seen), evidence.block)
        return known[seen]

    return gain


def _gain(change: Floats, block: Ints) -> Gain:
    inside = np.isfinite(change)
    if inside.sum() < LEFT * len(change):
        return Gain()
    change, block = change[inside], block[inside]
    _, block = np.unique(block, return_inverse=True)
    count = np.bincount(block)
    if len(count) < FEWEST:
        return Gain()
    means = np.bincount(block, np.clip(change, -MOST, MOST)) / count
    nats = OVERLAP * float((count * means).sum())
    return Gain(float(change.mean()), nats, float(means.sum()) / (float(np.abs(means).sum()) + 1e-9))


def _sum(gains: list[Gain]) -> float:
    return sum(gain.mean for gain in gains)
