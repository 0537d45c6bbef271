"""Mistakes of units, signs, axes and clocks that a recording shows by contradicting itself.

Three sources must agree: how measured distances and azimuths change, how the odometry says that the vehicle moves, and
where the reference sees it. `ALONE` and `DIRECTIONS` are the table of checks that need no correction to be tried. Most
mistakes show only between two sources: `contradictions` tries the corrections of the table in `mistakes`, and names
the one that makes the sources agree best.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from cellslam.benchmarks.scores.reference_fixes import usable
from cellslam.recordings.inspection.corrections import Correction, Drive, Fixes, dead_reckoned
from cellslam.recordings.inspection.mistakes import DEGREE, EXPLANATIONS, Explanation
from cellslam.recordings.inspection.path_evidence import PathEvidence
from cellslam.recordings.inspection.trajectory_evidence import RangeEvidence, ReferenceEvidence
from cellslam.sim.frames import wrap_angle
from cellslam.sim.plausible import RANGES
from cellslam.sim.recording import Floats, Ints, Recording
from cellslam.sim.recording.columns import COLUMNS
from cellslam.sim.recording.contract import TIMES, values_of

# Half a turn a second, rad/s: faster than any vehicle turns in a tenth of its drive; as many degrees a second are
# slower than its fastest turns, of which a hundredth is left out.
FASTEST_TURN, FASTEST_SHARE, OUTLYING = np.pi, 0.1, 0.01
WINDOW_S, FEWEST_WINDOWS = 1.0, 10  # over which a turn is averaged: headings that jitter are no turns
OTHER_UNIT = 10.0  # a factor of yaw rates beyond it, or below one over it, is another unit
LEAST_ANGLES = 50
START_M = 15.0  # so much of the path shows in which direction a drive starts
BACKWARDS = 0.8  # of the path: nobody drives so
ROUNDS = 5  # of refinement
FEWEST, LEFT = 6, 0.75  # blocks, and share of the stretches, that a delay must leave within the drive
STDS, NOISE_M = 5.0, 100.0  # of a clock's offset, and an error of a distance, which nothing sound goes beyond
OVERLAP = 0.5  # stretches overlap: so much of their number is independent
MOST = 5.0  # log-likelihood that a single stretch may give or take
NATS, AGREED = 10.0, 0.7  # least gain of all stretches, and how far blocks must agree
LEAST_GAIN = 0.5  # gain of a stretch that counts as much as any
AS_WELL, NEARLY = 0.9, 0.8  # shares of another's gain


@dataclass(frozen=True)
class Suspicion:
    """`kind`: one word to test for; `text`: what is suspected, why, what to do."""

    kind: str
    text: str


Check = Callable[[Recording], Iterator[Suspicion]]
Evidence = PathEvidence | ReferenceEvidence | RangeEvidence


def suspicions(recording: Recording) -> list[Suspicion]:
    """Return what looks wrong in a recording; none for sound data."""
    # What one table shows alone spoils all else; directions are told only where tables do not contradict each other.
    for checks in (ALONE, (contradictions,), DIRECTIONS, PLAUSIBLE):
        if found := [suspicion for check in checks for suspicion in check(recording)]:
            return found
    return []


def azimuths_as_degrees(recording: Recording) -> Iterator[Suspicion]:
    """Azimuths within +-pi degrees: radians that were read as degrees."""
    azimuth = recording.measurements.azimuth_rad
    azimuth = azimuth[~np.isnan(azimuth)]
    if len(azimuth) >= LEAST_ANGLES and np.abs(azimuth).max() <= np.pi * DEGREE * 1.01 and len(np.unique(azimuth)) > 9:
        yield Suspicion(
            "radians-as-degrees",
            f"all {len(azimuth)} azimuths lie within +-{np.abs(azimuth).max():.4f} rad: that is +-pi read as degrees; "
            'if the column is in radians already, say unit = "rad"',
        )


def whole_distances(recording: Recording) -> Iterator[Suspicion]:
    """Distances that are whole numbers of metres: delays in samples."""
    distance = recording.measurements.distance_m
    distance = distance[~np.isnan(distance)]
    if len(distance) >= LEAST_ANGLES and (distance == np.round(distance)).all() and len(np.unique(distance)) >= 5:
        yield Suspicion(
            "samples",
            f"all {len(distance)} distances are whole numbers of metres ({distance.min():.0f} to {distance.max():.0f})"
            ': are they delays in samples? say unit = "samples" and sample_rate_hz',
        )


def fast_turns(recording: Recording) -> Iterator[Suspicion]:
    """Yaw rates that no vehicle reaches: degrees that were taken for radians."""
    rate = _turn_rates(recording)
    if len(rate) >= FEWEST_WINDOWS and (fast := np.quantile(rate, 1.0 - FASTEST_SHARE)) > FASTEST_TURN:
        yield Suspicion(
            "degrees-as-radians",
            f"a tenth of the yaw rates u_psi exceed {fast:.1f} rad/s, too fast for a vehicle: were degrees taken for "
            'radians? say unit = "deg/s"',
        )


def _turn_rates(recording: Recording) -> Floats:
    """Return how fast the odometry turns (n,) in rad/s, without sign, averaged over windows of a second."""
    rate, times = recording.odometry[1:, 3], recording.time_s
    if np.isnan(rate).all():
        return np.empty(0)
    yaw = np.append(0.0, np.cumsum(np.nan_to_num(rate) * np.diff(times)))
    turned = np.diff(np.interp(np.arange(times[0], times[-1], WINDOW_S), times, yaw))
    return np.asarray(np.abs(turned) / WINDOW_S)


def yaw_of_reference(recording: Recording) -> Iterator[Suspicion]:
    """A reference whose yaw is not the direction in which it moves: a clockwise yaw, or one from elsewhere."""
    r = recording.reference
    if r is None or np.isnan(r.yaw_rad).all():
        return
    known = np.isfinite(r.position_m[:, :2]).all(axis=1) & np.isfinite(r.yaw_rad)
    place, yaw = r.position_m[known, :2], r.yaw_rad[known]
    step = place[2:] - place[:-2]
    length = np.hypot(*step.T)
    moving = length > 0.5 * np.median(length)
    course = np.arctan2(step[moving, 1], step[moving, 0])
    if not len(course) or length.max() == 0.0:
        return
    same, mirrored = (np.mean(np.exp(1j * (course + s * yaw[1:-1][moving]))) for s in (-1.0, 1.0))
    spread, angle = float(np.abs(np.mean(np.exp(1j * course)))), float(np.angle(same))
    if abs(mirrored) > 0.8 and abs(same) < 0.6 and spread < 0.9:
        yield Suspicion(
            "clockwise",
            f"the reference's yaw turns against its course (agreement {abs(same):.2f}, mirrored {abs(mirrored):.2f})"
            ": clockwise yaw; set sign = -1, and zero = 90 if it is counted from north, or exchange x_m and y_m",
        )
    elif abs(same) > 0.8 and abs(angle) > np.radians(45.0):
        backwards = "the vehicle seems to drive backwards: wrong sign of the yaw"
        what = backwards if abs(angle) > 2.3 else "yaw from north, or swapped axes"
        yield Suspicion(
            "yaw-zero",
            f"the reference moves {np.degrees(angle):.0f} deg away from its own yaw: {what}; set the yaw's zero",
        )


def start_against_odometry(recording: Recording) -> Iterator[Suspicion]:
    """A reference that leaves the start against the odometry: odometry of the wrong sign, or a start turned round."""
    fixes = _fixes_of(recording)
    if fixes is None or np.isnan(recording.odometry[:, 0]).all():
        return
    own = dead_reckoned(recording, fixes.time_s)[:, :2]
    travelled = np.cumsum(np.hypot(*np.diff(own, axis=0, prepend=own[:1]).T))
    end = int(np.searchsorted(travelled, START_M))
    if end == len(travelled):
        return
    a, b = own[end] - own[0], fixes.position_m[end] - fixes.position_m[0]
    turn = float(wrap_angle(np.arctan2(b[1], b[0]) - np.arctan2(a[1], a[0])))
    if abs(turn) > 0.75 * np.pi and np.hypot(*b) > 0.3 * START_M:
        yield Suspicion(
            "odometry-sign",
            f"from the start the reference goes {np.degrees(abs(turn)):.0f} deg away from where the odometry goes: the "
            "odometry has the wrong sign (set sign = -1 for u_x), or the start heading is turned round",
        )


def driving_backwards(recording: Recording) -> Iterator[Suspicion]:
    """A drive backwards, without azimuths: nothing else tells the sign but that vehicles go forward."""
    ahead = np.nan_to_num(recording.odometry[1:, 0]) * np.diff(recording.time_s)
    travelled, angles = float(np.abs(ahead).sum()), np.isfinite(recording.measurements.azimuth_rad).any()
    if not angles and travelled > START_M and ahead.sum() < -BACKWARDS * travelled:
        share = -float(ahead[ahead < 0].sum()) / travelled
        yield Suspicion(
            "odometry-sign",
            f"the odometry drives {100 * share:.0f} % of its distance backwards: if the vehicle did not, "
            "set sign = -1 for u_x",
        )


def unusual_values(recording: Recording) -> Iterator[Suspicion]:
    """Values beyond the usual (`sim.plausible`)."""
    values = values_of(recording)
    found = [(c.name, *part) for c in COLUMNS if c.path in values for part in c.parts(values[c.path])]
    steps = [(path, np.diff(values[path])) for path in TIMES if path in values]
    found += [(f"intervals of {path.replace('/', '.')}", RANGES["interval"], step) for path, step in steps]
    for name, span, values_held in found:
        column = np.atleast_1d(values_held)
        beyond = column[(column < span.usual[0]) | (column > span.usual[1])]
        if len(beyond):
            usual = f"{span.usual[0]:g} to {span.usual[1]:g} {span.unit} is usual ({span.why})"
            yield Suspicion("unusual", f"{len(beyond)} of {column.size} {name} are as {beyond[0]:.6g}: {usual}")


def negative_distances(recording: Recording) -> Iterator[Suspicion]:
    """Distances that the prior of the clock offset makes negative."""
    m, sites = recording.measurements, recording.sites
    lasts_s = float(recording.elapsed_s[-1])
    walked = sites.walk_densities[0] * np.sqrt(lasts_s) + sites.walk_densities[1] * lasts_s**1.5
    std = sites.clock_offset_std_m + sites.drift_std_m_s * lasts_s + walked + sites.step_std_m
    least = sites.clock_offset_mean_m - STDS * std - NOISE_M
    below = m.distance_m < least[recording.links.site[m.link]]
    if below.any():
        yield Suspicion(
            "negative-distances",
            f"{below.sum()} distances are too short for any transmitter, as {m.distance_m[below][0]:.6g} m in row "
            f"{np.flatnonzero(below)[0]}: state the site's clock offset and its deviation, or leave the rows out",
        )


ALONE: Sequence[Check] = (azimuths_as_degrees, whole_distances, fast_turns)
DIRECTIONS: Sequence[Check] = (yaw_of_reference, start_against_odometry, driving_backwards)
PLAUSIBLE: Sequence[Check] = (unusual_values, negative_distances)


class Gain(NamedTuple):
    """What a correction gains: log-likelihood of a stretch, and of all (each limited).

    `agreed`: what blocks of the drive gain less what others lose, as a share of both.
    """

    mean: float = 0.0
    nats: float = 0.0
    agreed: float = 0.0


@dataclass(frozen=True)
class Contradiction:
    """A correction that makes tables agree; `gains`: by the name of the evidence."""

    explanation: Explanation
    correction: Correction
    gains: Mapping[str, Gain]
    total: float

    @property
    def harmless(self) -> bool:
        """Whether the correction is too small to be a mistake."""
        return self.explanation.harmless(self.correction)

    def sure(self, evidence: str) -> bool:
        """Return whether it gains surely in some evidence."""
        gain = self.gains[evidence]
        return gain.mean > self.explanation.least and gain.nats > NATS and gain.agreed > AGREED


def contradictions(recording: Recording) -> Iterator[Suspicion]:
    """Tables that contradict each other: the correction that explains them best, and others that do so as well.

    It must gain surely in some evidence, and more there, or in all, than what is nobody's mistake does.
    """
    found = _ranked(_evidence_of(recording))
    small = [x for x in found if x.harmless]

    def grave(x: Contradiction) -> bool:
        """Return whether it gains surely, and nothing harmless gains nearly as much there or in all."""
        most = {e: max((o.gains[e].mean for o in small), default=-np.inf) for e in x.gains}
        alone = max((o.total for o in small), default=-np.inf) <= NEARLY * x.total
        return not x.harmless and any(
            x.sure(e) and (alone or most[e] <= NEARLY * gain.mean) for e, gain in x.gains.items()
        )

    turns = _turn_rates(recording)
    suspected = [x for x in found if grave(x) and _turns_like_a_vehicle(turns, abs(x.correction.yaw_rate))]
    best = sorted(suspected, key=lambda x: (x.total < AS_WELL * suspected[0].total, x.explanation.refined is not None))
    as_well = [x for x in best[1:] if x.total > AS_WELL * suspected[0].total and x.explanation.refined is None]
    for rank, x in enumerate([*best[:1], *as_well]):
        kind, text = x.explanation.diagnose(x.correction)
        tables = " and ".join(
            f"{name} (log-likelihood {g.mean:+.1f} a stretch)" for name, g in x.gains.items() if g.mean > 0.05
        )
        yield Suspicion(kind, f"{'or' if rank else 'it seems that'} {text}; then {tables} agree better")


def _turns_like_a_vehicle(rates: Floats, factor: float) -> bool:
    """Return whether turn rates (n,) in rad/s, if a factor makes them another unit, are then such as vehicles have."""
    if 1.0 / OTHER_UNIT < factor < OTHER_UNIT or not len(rates):
        return True
    fast = factor * float(np.quantile(rates, 1.0 - OUTLYING))
    return DEGREE * FASTEST_TURN < fast < FASTEST_TURN


def _ranked(evidence: list[Evidence]) -> list[Contradiction]:
    """Return the best correction of every explanation, by how much of what there is to explain it explains."""
    gain_in = [_gain_function(e) for e in evidence]

    def tried(corrections: Sequence[Correction]) -> list[tuple[float, Correction, list[Gain]]]:
        all_gains = ((c, [gain(c) for gain in gain_in]) for c in corrections)
        return [(sum(gain.mean for gain in gains), c, gains) for c, gains in all_gains]

    found = []
    for explanation in EXPLANATIONS:
        best = max(tried(explanation.corrections), key=lambda one: one[0])
        for k in range(ROUNDS):
            best = max([best, *tried(explanation.near(best[1], k))], key=lambda one: one[0])
        found.append((explanation, *best[1:]))
    most = [max(LEAST_GAIN, *(gains[i].mean for _, _, gains in found)) for i in range(len(evidence))]
    out = []
    for explanation, c, gains in found:
        total = sum(float(np.clip(g.mean / m, -1.0, 1.0)) for g, m in zip(gains, most, strict=True))
        out.append(Contradiction(explanation, c, {e.name: g for e, g in zip(evidence, gains, strict=True)}, total))
    return sorted(out, key=lambda x: -x.total)


def _gain_function(evidence: Evidence) -> Callable[[Correction], Gain]:
    """Return what a correction gains in some evidence, worked out once for all that come to the same there."""
    gain = cache(lambda effect: _gain(evidence.change(effect), evidence.block))
    return lambda correction: gain(evidence.effect_of(correction))


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


def _evidence_of(recording: Recording) -> list[Evidence]:
    """Return the comparisons that a recording allows."""
    fixes, drive = _fixes_of(recording), Drive(recording)
    with_odometry = len(recording.time_s) > 2 and not np.isnan(recording.odometry[:, 0]).all()
    of_paths = RangeEvidence if np.isnan(recording.measurements.azimuth_rad).all() else PathEvidence
    makers: list[Callable[[], Evidence]] = []
    if with_odometry:
        makers.append(lambda: of_paths(recording, drive))
    if with_odometry and fixes is not None:
        makers.append(lambda: ReferenceEvidence(drive, fixes))
    if fixes is not None:
        makers.append(lambda: of_paths(recording, fixes))
    found = []
    for make in makers:
        try:
            found.append(make())
        except ValueError:  # too little of it
            continue
    return found


def _fixes_of(recording: Recording) -> Fixes | None:
    """Return where the vehicle is known to have been, within the drive."""
    r = recording.reference
    if r is not None:
        rows = usable(recording, r)
        yaw = r.yaw_rad[rows] if np.isfinite(r.yaw_rad[rows]).all() else None
        return Fixes(r.time_s[rows], r.position_m[rows, :2], yaw) if rows.sum() > 2 else None
    if recording.truth is None:
        return None
    return Fixes(recording.time_s, recording.truth.poses[:, :2], recording.truth.poses[:, 3])
