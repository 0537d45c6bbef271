"""Mistakes of units, signs, axes and clocks that a recording shows by contradicting itself.

Three sources must agree: how measured distances and azimuths change, how the odometry says that the vehicle moves, and
where the reference sees it. Where they do not, the correction is looked for that makes them (`contradictions`). What a
table shows alone is checked here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cellslam.recordings.inspection.contradictions import Contradiction, contradictions, fixes_of
from cellslam.recordings.inspection.corrections import dead_reckoned
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Recording

DEGREE = np.pi / 180.0
FASTEST_TURN = 2.5  # rad/s: faster than any road vehicle, for its upper decile
LEAST_ANGLES = 50
START_M = 15.0  # so much of the path shows in which direction a drive starts
BACKWARDS = 0.8  # of the path: nobody drives so
TABLES = {
    "paths": "measured paths and odometry",
    "reference": "reference and odometry",
    "ranges": "distances and odometry",
    "places": "distances and reference",
}


@dataclass(frozen=True)
class Suspicion:
    """`kind`: one word to test for; `text`: what is suspected, why, what to do."""

    kind: str
    text: str


def suspicions(recording: Recording) -> list[Suspicion]:
    """Return what looks wrong in a recording; none for sound data."""
    units = [*_angles(recording), *_whole_numbers(recording), *_turning(recording)]
    if units:  # what they spoil contradicts everything else
        return units
    found = [_said(c, i) for i, c in enumerate(contradictions(recording))]
    if not found:
        found = [*_headings(recording), *_start(recording), *_backwards(recording)]
    return found


def _said(c: Contradiction, rank: int) -> Suspicion:
    kind, text = c.explanation.say(c.correction)
    tables = " and ".join(
        f"{TABLES[name]} (log-likelihood {g.mean:+.1f} a stretch)" for name, g in c.gains.items() if g.mean > 0.05
    )
    return Suspicion(kind, f"{'or' if rank else 'it seems that'} {text}; then {tables} agree better")


def _angles(recording: Recording) -> Iterator[Suspicion]:
    azimuth = recording.measurements.azimuth_rad
    azimuth = azimuth[~np.isnan(azimuth)]
    if len(azimuth) >= LEAST_ANGLES and np.abs(azimuth).max() <= np.pi * DEGREE * 1.01 and len(np.unique(azimuth)) > 9:
        yield Suspicion(
            "radians-as-degrees",
            f"all {len(azimuth)} azimuths lie within +-{np.abs(azimuth).max():.4f} rad: that is +-pi read as degrees; "
            'if the column is in radians already, say unit = "rad"',
        )


def _whole_numbers(recording: Recording) -> Iterator[Suspicion]:
    distance = recording.measurements.distance_m
    distance = distance[~np.isnan(distance)]
    if len(distance) >= LEAST_ANGLES and (distance == np.round(distance)).all() and len(np.unique(distance)) >= 5:
        yield Suspicion(
            "samples",
            f"all {len(distance)} distances are whole numbers of metres ({distance.min():.0f} to {distance.max():.0f})"
            ': are they delays in samples? say unit = "samples" and sample_rate_hz',
        )


def _turning(recording: Recording) -> Iterator[Suspicion]:
    rate = np.abs(recording.odometry[1:, 3])
    rate = rate[np.isfinite(rate)]
    if len(rate) and np.quantile(rate, 0.9) > FASTEST_TURN:
        yield Suspicion(
            "degrees-as-radians",
            f"a tenth of the yaw rates u_psi exceed {np.quantile(rate, 0.9):.1f} rad/s, too fast for a vehicle: were "
            'degrees taken for radians? say unit = "deg/s"',
        )


def _headings(recording: Recording) -> Iterator[Suspicion]:
    """Compare the reference's yaw with the direction in which it moves."""
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
    spread = float(np.abs(np.mean(np.exp(1j * course))))
    if abs(mirrored) > 0.8 and abs(same) < 0.6 and spread < 0.9:
        yield Suspicion(
            "clockwise",
            f"the reference's yaw turns against its course (agreement {abs(same):.2f}, mirrored {abs(mirrored):.2f})"
            ": clockwise yaw; set sign = -1, and zero = 90 if it is counted from north, or exchange x_m and y_m",
        )
    angle = float(np.angle(same))
    if abs(same) > 0.8 and abs(angle) > np.radians(45.0):
        backwards = "the vehicle seems to drive backwards: wrong sign of the yaw"
        what = backwards if abs(angle) > 2.3 else "yaw from north, or swapped axes"
        yield Suspicion(
            "yaw-zero",
            f"the reference moves {np.degrees(angle):.0f} deg away from its own yaw: {what}; set the yaw's zero",
        )


def _start(recording: Recording) -> Iterator[Suspicion]:
    """Compare where odometry and reference go from the start."""
    fixes = fixes_of(recording)
    if fixes is None or np.isnan(recording.odometry[:, 0]).all():
        return
    own = dead_reckoned(recording, fixes[0])[:, :2]
    travelled = np.cumsum(np.hypot(*np.diff(own, axis=0, prepend=own[:1]).T))
    end = int(np.searchsorted(travelled, START_M))
    if end == len(travelled):
        return
    a, b = own[end] - own[0], fixes[1][end] - fixes[1][0]
    turn = float(wrap_angle(np.arctan2(b[1], b[0]) - np.arctan2(a[1], a[0])))
    if abs(turn) > 0.75 * np.pi and np.hypot(*b) > 0.3 * START_M:
        yield Suspicion(
            "odometry-sign",
            f"from the start the reference goes {np.degrees(abs(turn)):.0f} deg away from where the odometry goes: the "
            "odometry has the wrong sign (set sign = -1 for u_x), or the start heading is turned round",
        )


def _backwards(recording: Recording) -> Iterator[Suspicion]:
    """Without azimuths nothing tells forward from backward but that vehicles go forward."""
    ahead = np.nan_to_num(recording.odometry[1:, 0]) * np.diff(recording.time_s)
    travelled = float(np.abs(ahead).sum())
    if (
        np.isnan(recording.measurements.azimuth_rad).all()
        and travelled > START_M
        and ahead.sum() < -BACKWARDS * travelled
    ):
        share = -float(ahead[ahead < 0].sum()) / travelled
        yield Suspicion(
            "odometry-sign",
            f"the odometry drives {100 * share:.0f} % of its distance backwards: if the vehicle did not, "
            "set sign = -1 for u_x",
        )
