"""Mistakes of units, signs and axes that a recording shows by contradicting itself.

Three sources must agree: how measured distances and azimuths change, how the odometry says that the vehicle moves, and
where the reference sees it. For a path that stays, over a short drive with displacement D and turn psi in the body
frame,

    change of distance = -D . (cos azimuth, sin azimuth),    change of azimuth = -psi + parallax,

whatever the clock offset is. A mistake of unit or sign shows as a slope other than one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.benchmarks.recordings.inspection.contradictions import Slopes, Track, reference_track, slopes
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.recording import Recording

NANOSECOND_M = SPEED_OF_LIGHT_MPS * 1e-9
DEGREE = np.pi / 180.0
CLOSE = 0.2  # a factor counts as recognised within so much of it
SURE = 5.0  # standard errors
FASTEST_TURN = 2.5  # rad/s: faster than any road vehicle, for its upper quartile
LEAST_ANGLES = 50


@dataclass(frozen=True)
class Suspicion:
    """`kind`: one word to test for; `text`: what is suspected, why, what to do."""

    kind: str
    text: str


def suspicions(recording: Recording) -> list[Suspicion]:
    """Return what looks wrong in a recording; none for sound data."""
    found = [*_angles(recording), *_whole_numbers(recording), *_turning(recording)]
    fitted, track = slopes(recording), reference_track(recording)
    if fitted is not None and not any(s.kind == "radians-as-degrees" for s in found):
        found += _distances(recording, fitted)
        found += [] if any(s.kind == "samples" for s in found) else _azimuths(fitted, track)
    if track is not None:
        found += [*_against_reference(track, fitted)]
    kinds: dict[str, Suspicion] = {}
    for suspicion in found:
        kinds.setdefault(suspicion.kind, suspicion)
    return list(kinds.values())


def _angles(recording: Recording) -> list[Suspicion]:
    out = []
    m = recording.measurements
    azimuth = m.azimuth_rad[~np.isnan(m.azimuth_rad)]
    if len(azimuth) >= LEAST_ANGLES and np.abs(azimuth).max() <= np.pi * DEGREE * 1.01 and len(np.unique(azimuth)) > 9:
        out.append(
            Suspicion(
                "radians-as-degrees",
                (
                    f"all {len(azimuth)} azimuths lie within +-{np.abs(azimuth).max():.4f} rad: that is +-pi "
                    f"read as degrees; if the "
                    'column is in radians already, say unit = "rad"'
                ),
            )
        )
    return out


def _whole_numbers(recording: Recording) -> list[Suspicion]:
    distance = recording.measurements.distance_m
    distance = distance[~np.isnan(distance)]
    if len(distance) < LEAST_ANGLES or (distance != np.round(distance)).any() or len(np.unique(distance)) < 5:
        return []
    text = (
        f"all {len(distance)} distances are whole numbers of metres ({distance.min():.0f} to "
        f"{distance.max():.0f}): are they "
        'delays in samples? say unit = "samples" and sample_rate_hz'
    )
    return [Suspicion("samples", text)]


def _turning(recording: Recording) -> list[Suspicion]:
    rate = np.abs(recording.odometry[1:, 3])
    rate = rate[np.isfinite(rate)]
    if len(rate) and np.quantile(rate, 0.9) > FASTEST_TURN:
        text = (
            f"a tenth of the yaw rates u_psi exceed {np.quantile(rate, 0.9):.1f} rad/s, too fast for a vehicle: "
            f"were degrees "
            'taken for radians? say unit = "deg/s"'
        )
        return [Suspicion("degrees-as-radians", text)]
    return []


def _distances(recording: Recording, fitted: Slopes) -> list[Suspicion]:
    size, angle = fitted.distance, fitted.azimuth_zero_rad
    if not fitted.distance_error < size / SURE:
        return []
    out = []
    why = f"distances change {size:.2f} +- {fitted.distance_error:.2f} times as fast as odometry and azimuth tell"
    if abs(angle) > 0.75 * np.pi and fitted.azimuth_zero_error < 0.3:
        out.append(
            Suspicion(
                "odometry-sign",
                (
                    f"distances shrink where they should grow ({fitted.pairs} pairs of snapshots; azimuths off by "
                    f"{np.degrees(angle):.0f} deg): the odometry has the wrong sign (forward is positive), or "
                    f"azimuths are counted "
                    "from behind; set sign = -1 for u_x, or zero = 180 for the azimuth"
                ),
            )
        )
    elif abs(angle) > np.radians(30.0) and fitted.azimuth_zero_error < 0.3:
        out.append(
            Suspicion(
                "azimuth-zero",
                (
                    f"distances change as if every azimuth were {np.degrees(angle):.0f} deg too large "
                    f"({fitted.pairs} pairs of "
                    "snapshots): swapped axes, or azimuths that are not counted from straight ahead; set the "
                    "azimuth's zero and sign"
                ),
            )
        )
    sure = fitted.distance_error * SURE
    if size - sure > 1.5 or size + sure < 0.6:
        guess = _named(
            size,
            {
                "samples": 0.0,
                'delays in ns taken for metres (say unit = "ns")': 1.0 / NANOSECOND_M,
                'metres taken for delays in ns (say unit = "m")': NANOSECOND_M,
                'speeds in m/s taken for km/h (say unit = "m/s")': 1.0 / 3.6,
                'speeds in km/h taken for m/s (say unit = "km/h")': 1.0 / 3.6,
                'kilometres taken for metres (say unit = "km")': 1e-3,
            },
        )
        whole = " (they are whole numbers)" if _whole_numbers(recording) else ""
        other = 'delays in samples (say unit = "samples" and sample_rate_hz), or a wrong unit of speed'
        text = f"{why}{whole}: {guess or other}"
        kind = "nanoseconds" if guess.startswith("delays in ns") else "distance-unit"
        out.append(Suspicion(kind, text))
    return out


def _azimuths(fitted: Slopes, track: Track | None) -> list[Suspicion]:
    slope, error = fitted.turn, fitted.turn_error
    if not np.isfinite(slope) or error * SURE > max(abs(slope), 0.02):
        return []
    why = f"azimuths change {slope:+.3f} +- {error:.3f} times as fast as the yaw rate tells ({fitted.turns} pairs)"
    if slope < -0.5:
        turns = 0.0 if track is None or not np.isfinite(track.turn_slope) else track.turn_slope
        cause = "clockwise azimuths, or a clockwise yaw rate; set sign = -1 for azimuth_rad or u_psi, the one that is"
        if turns < -0.2:
            cause = "a clockwise yaw rate, since the reference turns against it too; set sign = -1 for u_psi"
        elif turns > 0.5:
            cause = "clockwise azimuths, since the reference agrees with the yaw rate; set sign = -1 for azimuth_rad"
        return [Suspicion("clockwise", f"{why}: {cause}")]
    if slope < 0.1 and fitted.turned_rad > 0.05:
        text = f'{why}: yaw rates in degrees taken for radians? say unit = "deg/s"'
        return [Suspicion("degrees-as-radians", text)]
    if slope > 10.0:
        text = f'{why}: yaw rates in radians taken for degrees? say unit = "rad/s"'
        return [Suspicion("radians-as-degrees", text)]
    return []


def _against_reference(track: Track, fitted: Slopes | None) -> list[Suspicion]:
    out = [*_headings(track)]
    if np.isfinite(track.length_ratio) and not 0.6 < track.length_ratio < 1.6:
        guess = _named(
            track.length_ratio,
            {
                'speeds in km/h taken for m/s (say unit = "km/h")': 3.6,
                "a reference or a clock in other units": 1e3,
                'speeds in m/s taken for km/h (say unit = "m/s")': 1.0 / 3.6,
            },
        )
        why = f"the odometry drives {track.length_ratio:.2f} times as far as the reference"
        out.append(Suspicion("speed-unit", f"{why}: {guess or 'a wrong unit of speed'}"))
    if track.turn_slope < -0.3 and track.turn_slope + SURE * track.turn_error < 0.0:
        turned = fitted is not None and np.isfinite(fitted.turn) and fitted.turn > 0.5
        cause = (
            "its x and y are swapped (north taken for east), since the azimuths agree with the odometry: "
            "exchange x_m and y_m"
            if turned
            else "clockwise yaw rate (set sign = -1 for u_psi), or x and y of the reference swapped (exchange them)"
        )
        kind = "swapped-axes" if turned else "clockwise"
        why = f"the reference turns {track.turn_slope:+.2f} +- {track.turn_error:.2f} times as fast as the odometry"
        out.append(Suspicion(kind, f"{why}: {cause}"))
    elif track.turn_slope > 10.0 and SURE * track.turn_error < track.turn_slope:
        why = f"the reference turns {track.turn_slope:.0f} times as much as the odometry"
        out.append(
            Suspicion("radians-as-degrees", f'{why}: yaw rates in radians taken for degrees? say unit = "rad/s"')
        )
    elif track.turn_slope + SURE * track.turn_error < 0.1:
        why = f"the reference turns {track.turn_slope:+.3f} +- {track.turn_error:.3f} times as fast as the odometry"
        out.append(
            Suspicion("degrees-as-radians", f'{why}: yaw rates in degrees taken for radians? say unit = "deg/s"')
        )
    if np.isfinite(track.start_turn_rad) and abs(track.start_turn_rad) > 0.75 * np.pi:
        out.append(
            Suspicion(
                "odometry-sign",
                (
                    f"from the start the reference goes {np.degrees(abs(track.start_turn_rad)):.0f} deg away "
                    f"from where the odometry goes: "
                    "the odometry has the wrong sign (set sign = -1 for u_x), or the start heading is turned round"
                ),
            )
        )
    return out


def _headings(track: Track) -> list[Suspicion]:
    """Compare the reference's yaw with the direction in which it moves."""
    if not len(track.course_rad):
        return []
    same, mirrored = (np.mean(np.exp(1j * (track.course_rad + s * track.yaw_rad))) for s in (-1.0, 1.0))
    spread = float(np.abs(np.mean(np.exp(1j * track.course_rad))))
    if abs(mirrored) > 0.8 and abs(same) < 0.6 and spread < 0.9:
        text = (
            f"the reference's yaw turns against its own course (agreement {abs(same):.2f}, mirrored "
            f"{abs(mirrored):.2f}): "
            "clockwise yaw; set sign = -1, and zero = 90 if it is counted from north, or exchange x_m and y_m"
        )
        return [Suspicion("clockwise", text)]
    angle = float(np.angle(same))
    if abs(same) > 0.8 and abs(angle) > np.radians(45.0):
        what = (
            "the vehicle seems to drive backwards: wrong sign of the yaw"
            if abs(angle) > 2.3
            else "yaw from north, or swapped axes"
        )
        text = f"the reference moves {np.degrees(angle):.0f} deg away from its own yaw: {what}; set the yaw's zero"
        return [Suspicion("yaw-zero", text)]
    return []


def _named(factor: float, known: dict[str, float]) -> str:
    return next((name for name, value in known.items() if value > 0 and abs(np.log(factor / value)) < CLOSE), "")
