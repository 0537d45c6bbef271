"""Noise, detection and clutter as the tracks of a recording's measurements show them, before any filter has run.

White noise: the spread of second differences of innovations along tracks, n(t+2) - 2 n(t+1) + n(t), whose variance is
six times that of one measurement, however smoothly everything else changes. Persisting errors: `fit_persisting`.
Detection: the share of snapshots within the life of a track that have it. Clutter: rows in no track, per link and
snapshot and volume.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from pydantic import BaseModel

from cellslam.recordings.fitting.fit_persisting import NAMES, in_unit, persisting, reach
from cellslam.recordings.fitting.fit_tracks import QUANTITIES, Tracks, polled_share, robust_std, tracks_of
from cellslam.recordings.inspection.corrections import dead_reckoned
from cellslam.sim.errors import InputError
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints, Recording
from cellslam.slam.measurements.measurement_options import NOTHING_PERSISTS, MeasurementOptions
from cellslam.slam.measurements.readings import CLUTTER_WIDTH

LEAST_TRIPLES, LEAST_TRACKED, BINS = 100, 15, 8
BIRTH_RATIO = (0.01, 0.5)  # bounds of what is learnt
LEAST_WHITE = 1e-3  # m and deg: no filter can take a measurement for exact
# Of a front end that nobody modelled. What persists is small, not nothing: what is left out cannot be learnt.
UNKNOWN = {
    **NOTHING_PERSISTS, "noise_floor_m": 0.3, "noise_floor_azimuth_deg": 2.0, "noise_floor_elevation_deg": 2.0,
    "noise_unit_snr_m": 0.0, "noise_unit_snr_azimuth_deg": 0.0, "noise_unit_snr_elevation_deg": 0.0,
    "diffuse_m": 0.1, "diffuse_azimuth_deg": 0.6, "diffuse_elevation_deg": 0.6, "diffuse_scale_m": 1.0,
    "slip_probability": 0.05,
}  # fmt: skip
LEAST_EXTENT_M = 10.0
LEAST_PERSISTING = 0.3  # of white noise
PLANE_ELEVATION_DEG = 0.5  # what estimators assume of the zero elevations of one plane


def unmodelled(recording: Recording) -> dict[str, float]:
    """Return the options (m, deg, s), by name, of a front end that nobody modelled, before anything is learnt.

    Where links are polled in turn, a snapshot says nothing of those that were not polled: as nobody knows which these
    are, detections and clutter are so much rarer. VTs are typically as far away as the drive extends. Where a recording
    has deviations of its own measurements, white errors are as large as most of these say.
    """
    share, usual, m = polled_share(recording), MeasurementOptions(), recording.measurements
    out = UNKNOWN | {"typical_range_m": extent_of(recording)}
    out |= {name: share * getattr(usual, name) for name in ("detection_probability", "clutter_density")}
    for name, stated in zip(QUANTITIES, (m.distance_std_m, m.azimuth_std_rad, m.elevation_std_rad), strict=True):
        if stated is not None and np.isfinite(stated).any():
            white = in_unit(name, float(np.nanmedian(stated)))
            out |= {f"noise_floor_{NAMES[name]}": white, f"diffuse_{NAMES[name]}": LEAST_PERSISTING * white}
    return out


def known_to(model: type[BaseModel], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of some options, by name, that an estimator's model has."""
    return {name: value for name, value in options.items() if name in model.model_fields}


def extent_of(recording: Recording) -> float:
    """Return how far a drive extends, in m: the diagonal of the rectangle about it by its odometry, LEAST_EXTENT_M at
    least; where it is larger than the range that is usual, or there are no azimuths or no odometry, that range."""
    usual = MeasurementOptions().typical_range_m
    diagonal = float(np.hypot(*np.ptp(dead_reckoned(recording, recording.time_s)[:, :2], axis=0)))
    if np.isnan(recording.measurements.azimuth_rad).all() or not diagonal:
        return usual
    return min(max(diagonal, LEAST_EXTENT_M), usual)


def initial_options(recording: Recording) -> dict[str, float]:
    """Return the front-end options (m, deg, s) that the tracks of a recording give, by name; what these do not tell is
    as of a front end that nobody modelled.

    Raises InputError where there are too few tracks to tell.
    """
    m = recording.measurements
    if np.isnan(m.distance_m).all() and np.isnan(m.azimuth_rad).all():
        raise InputError("fit-noise needs distances or azimuths, and the recording has neither")
    tracks = tracks_of(recording)
    tracked = int((tracks.track >= 0).sum())
    count = len(np.unique(tracks.track[tracks.track >= 0]))
    if tracked < LEAST_TRACKED:
        raise InputError(
            f"fit-noise found {count} tracks of three detections or more, with {tracked} in all, and needs "
            f"{LEAST_TRACKED}: is the odometry right?"
        )
    detection_probability, visible_s = _detection(recording, tracks)
    range_m, range_known = reach(recording, tracks)
    out = UNKNOWN | {
        "typical_range_m": range_m if range_known else extent_of(recording),
        "detection_probability": detection_probability,
        "clutter_density": polled_share(recording) * _clutter(recording, tracks),
        "visible_s": visible_s,
        "birth_ratio": float(np.clip(count / (count + (tracks.track < 0).sum()), *BIRTH_RATIO)),
    }
    white, against_snr = dict[str, float](), dict[str, tuple[float, float]]()
    middle, difference = _triples(tracks)
    for i, name in enumerate(QUANTITIES):
        known = ~np.isnan(difference[:, i])
        if known.sum() >= LEAST_TRIPLES:
            key, values = NAMES[name], difference[known, i]
            floor, unit = _against_snr(values, m.snr_db[middle[known]])
            against_snr[key] = in_unit(name, floor), in_unit(name, unit)
            white[key] = in_unit(name, _deviation(values))
    if recording.plane:
        against_snr["elevation_deg"] = PLANE_ELEVATION_DEG, 0.0
    place, direction, scale_m = persisting(recording, tracks, white)
    for key, (floor, unit) in against_snr.items():
        out |= {
            f"noise_floor_{key}": max(floor, LEAST_WHITE),
            f"noise_unit_snr_{key}": unit,
            f"diffuse_{key}": max(place.get(key, 0.0), LEAST_PERSISTING * float(np.hypot(floor, unit))),
            f"calibration_{key}": direction.get(key, 0.0),
        }
    return out | ({"diffuse_scale_m": scale_m} if scale_m else {})


def _triples(tracks: Tracks) -> tuple[Ints, Floats]:
    """Return pairs of steps that follow one another, each of as many snapshots as most have: their middle rows and
    second differences (n, 3).
    """
    steps = tracks.steps
    tracked = tracks.track[steps.first] >= 0
    single = np.flatnonzero(tracked & (steps.lag == np.bincount(steps.lag[tracked], minlength=2).argmax()))
    at = np.full(len(tracks.track), -1, np.int64)
    at[steps.first[single]] = single
    following = at[steps.second[single]]
    pairs = following >= 0
    one, two = single[pairs], following[pairs]
    difference = steps.innovation[two] - steps.innovation[one]
    difference[:, 1] = wrap_angle(difference[:, 1])
    return steps.second[one], difference


def _deviation(second_differences: Floats) -> float:
    return robust_std(second_differences) / float(np.sqrt(6.0))


def _against_snr(values: Floats, snr_db: Floats) -> tuple[float, float]:
    """Return floor and deviation at 0 dB of variance = floor^2 + unit^2 / SNR, fitted to bins of equal count."""
    from scipy.optimize import nnls

    known = ~np.isnan(snr_db)
    if known.sum() < LEAST_TRIPLES or np.ptp(snr_db[known]) < 3.0:
        return _deviation(values), 0.0
    order = np.argsort(snr_db[known])
    parts = np.array_split(order, BINS)
    variance = np.array([_deviation(values[known][part]) ** 2 for part in parts])
    inverse = np.array([np.median(10.0 ** (-snr_db[known][part] / 10.0)) for part in parts])
    design = np.column_stack([np.ones(BINS), inverse]) / variance[:, None]
    solution, _ = nnls(design, np.ones(BINS))
    return float(np.sqrt(solution[0])), float(np.sqrt(solution[1]))


def _detection(r: Recording, tracks: Tracks) -> tuple[float, float]:
    """Return the share of snapshots between a track's first and last detection that have it, and its mean life in s."""
    rows = np.flatnonzero(tracks.track >= 0)
    snapshots = pd.Series(r.measurements.snapshot[rows]).groupby(tracks.track[rows])
    count, first, last = snapshots.agg(["count", "min", "max"]).to_numpy().T
    inner = last - first - 1
    share = (count - 2).sum() / max(inner.sum(), 1)
    life = r.time_s[last] - r.time_s[first]
    return float(np.clip(share, 0.01, 0.99)), float(max(np.average(life, weights=count), 1e-3))


def _clutter(r: Recording, tracks: Tracks) -> float:
    """Return rows without a track per link, epoch and m rad rad (over the middle 90 % of their distances)."""
    m = r.measurements
    loose = np.flatnonzero(tracks.track < 0)
    seen = len(np.unique((m.snapshot * max(len(r.links), 1) + m.link)[: len(tracks.track)]))
    # A component that is not measured: the width that the filters take off the density for it.
    volume = CLUTTER_WIDTH[1] if np.isnan(m.azimuth_rad).all() else 2.0 * np.pi
    volume *= _spread(m.distance_m, loose, 1.0, 1000.0, CLUTTER_WIDTH[0])
    if r.plane:
        volume *= np.sqrt(2.0 * np.pi) * np.radians(PLANE_ELEVATION_DEG)
    else:
        volume *= _spread(m.elevation_rad, loose, 0.01, np.pi / 2.0, CLUTTER_WIDTH[2])
    return float(np.clip(max(len(loose), 1) / max(seen, 1) / volume, 1e-9, 1e3))


def _spread(values: Floats, rows: Ints, least: float, most: float, missing: float) -> float:
    """Return the width of the middle 90 % of some rows of values (n,), at least `least`; `most` if those are too few to
    tell, `missing` if nothing was measured at all.
    """
    if np.isnan(values).all():
        return missing
    measured = values[rows][~np.isnan(values[rows])]
    return max(float(np.diff(np.quantile(measured, (0.05, 0.95)))[0]), least) if len(measured) > 20 else most
