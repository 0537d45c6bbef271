"""The errors that persist, as states of the bound's recursion.

Calibration and roof are random functions of the direction in the body frame with correlation exp(-chord^2 / (2 l^2)):
sums of fixed functions with weights that are constant and independent. One that is smooth over the drive's directions
needs few: the principal ones (Karhunen-Loeve). A rougher one gets bell functions on a grid of directions, whose weights
enter and leave as the drive passes. All links and VTs share them. Diffuse energy (per VT and port) and the turns of the
array (all paths) live shortly against the drive's own errors, so that only the area below the correlation counts: a
first-order Gauss-Markov state with the same area stands for them. For slowly changing errors it would not do: it takes
them as rougher than they are, and the bound comes out half as high again as it is. What merging does to a VT
(`merged_paths`) jumps, as such a state does.

Sources: Williams and Rasmussen, "Gaussian processes for machine learning", 2006, section 4.3 (principal functions,
Nystrom's method); Higdon, "A process-convolution approach to modelling temperatures in the North Atlantic Ocean",
Environmental and Ecological Statistics 5, 1998 (bell functions on a grid); Gelb, "Applied optimal estimation", 1974,
chapter 3 (Gauss-Markov states).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from cellslam.sim.errors import InputError
from cellslam.sim.lte.persisting_errors import Cause, causes, persisting_std
from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.recording import Floats, Ints, Recording

# The area below exp(-x^2 / (2 l^2)) is that below exp(-x / (AREA l)).
AREA = np.sqrt(np.pi / 2.0)
BY_TIME, BY_PLACE, BY_MERGING = 1, 2, 3
# Principal functions: share of the variance that may be missing, and the most of them.
MISSING = 0.001
MOST_FUNCTIONS = 100
# Bell functions: spacing and radius over correlation length. Their correlation is right to 0.1, 0.03 rms.
SPACING, RADIUS = 1.1, 1.7
# A weight that was not met for so long is forgotten: keeps the state small.
HOLD_S = 200.0
HOLD_SCALES = 8.0
NOTHING = Cause("", np.zeros(3), 0.0)


@dataclass(frozen=True)
class Persisting:
    """The E errors that persist, and the loads on them of n views, `state` and `load` (n, 3, W), and of m measurements,
    `own_state` (m, 3) and `own_load` (3,): numbers of errors, -1: none.

    `first`, `last` (E,): snapshots with the first and the last use; `kind` (E,): column of `decay` (T, 4), see
    `linear_model.States`; `variance` (3,): the marginal variances of what persists.
    """

    state: Ints
    load: Floats
    own_state: Ints
    own_load: Floats
    first: Ints
    last: Ints
    kind: Ints
    decay: Floats
    variance: Floats


@dataclass(frozen=True)
class Seen:
    """What the drive sees, sorted by snapshot. Views: `snapshot` (n,), body-frame `azimuth_rad`, `elevation_rad` (n,).
    Measurements: `view_of`, `vt`, `port` (m,).
    """

    snapshot: Ints
    azimuth_rad: Floats
    elevation_rad: Floats
    view_of: Ints
    vt: Ints
    port: Ints

    @property
    def direction(self) -> Floats:
        """Unit vectors (n, 3) in the body frame; dimensionless."""
        flat = np.cos(self.elevation_rad)
        return np.stack(
            [flat * np.cos(self.azimuth_rad), flat * np.sin(self.azimuth_rad), np.sin(self.elevation_rad)], axis=1
        )


@dataclass(frozen=True)
class Part:
    """One cause: `state` and `load` as in Views or Sightings, its states numbered from 0, how many, and their kind.

    Numbers of many views have 32 bits: there are millions.
    """

    state: NDArray[np.signedinteger[Any]]
    load: Floats
    count: int
    kind: int


def persisting_errors(
    recording: Recording, seen: Seen, calibrated: bool = False, merging: Cause | None = None
) -> Persisting:
    """Return the persisting errors of a recording with truth, those of the array left out where it is `calibrated`.

    `merging`: what it does to each VT, changing over a time. Raises InputError where the causes are not known.
    """
    assert recording.truth is not None
    views, snapshots, config = len(seen.snapshot), len(recording.time_s), radio_of(recording)
    known = [NOTHING] * 4 if config is None else causes(config)
    noise_scale = 0.0 if config is None else config.noise_scale
    calibration, roof, diffuse, attitude = (replace(c, std=noise_scale * c.std * (c.scale > 0.0)) for c in known)
    merging, calibration = merging or NOTHING, NOTHING if calibrated else calibration
    decay = np.ones((snapshots, 4))
    moved = np.linalg.norm(np.diff(recording.truth.poses[:, :3], axis=0), axis=1)
    decay[1:, BY_TIME] = _factor(np.diff(recording.time_s), attitude.scale)
    decay[1:, BY_PLACE] = _factor(moved, diffuse.scale)
    decay[1:, BY_MERGING] = _factor(np.diff(recording.time_s), merging.scale / AREA)
    parts = [
        _by_direction(calibration, seen, recording.time_s),
        _by_direction(roof, seen, recording.time_s),
        Part(np.tile(np.arange(3, dtype=np.int32), (views, 3, 1)), attitude.std[[1, 2, 2]] * turned(seen), 3, BY_TIME),
        _by_vt(merging, seen, recording.time_s),
    ]
    own = _by_place(diffuse, seen, np.concatenate([[0.0], np.cumsum(moved)]))
    base = np.concatenate([[0], np.cumsum([part.count for part in parts])]).astype(np.int32)
    state = np.concatenate([np.where(q.state >= 0, b + q.state, -1) for q, b in zip(parts, base, strict=False)], axis=2)
    load = np.concatenate([part.load for part in parts], axis=2)
    state = np.where(load != 0.0, state, -1)
    own_state = np.where((own.state >= 0) & (own.load > 0.0), base[-1] + own.state, -1)
    first, last = np.full((2, base[-1] + own.count), -1)
    for states, at in ((state, seen.snapshot[:, None, None]), (own_state, seen.snapshot[seen.view_of, None])):
        there = states >= 0
        met, when = states[there], np.broadcast_to(at, states.shape)[there]
        # Sorted by snapshot: of several values for one state the last stays.
        last[met], first[met[::-1]] = when, when[::-1]
    variance = np.zeros(3) if config is None else persisting_std(config) ** 2
    kind = np.repeat([part.kind for part in [*parts, own]], [part.count for part in [*parts, own]])
    return Persisting(state, load, own_state, own.load, first, last, kind, decay, variance)


def _factor(step: Floats, scale: float) -> Floats:
    """Return how much of a Gauss-Markov state is left after steps (n,) in the unit of `scale` (0: nothing)."""
    return np.exp(-step / (AREA * scale)) if scale > 0.0 else np.zeros(len(step))


def radio_of(recording: Recording) -> RadioConfig | None:
    """Return the receiver whose errors persist, from the provenance; None where all errors are white."""
    assert recording.truth is not None
    std = recording.truth.persisting_std
    real = recording.truth.measurement_vt >= 0
    if std is None or not (std[real] > 0.0).any():
        return None
    try:
        config = RadioConfig(**recording.provenance["world"]["radio"])
    except (KeyError, TypeError, ValidationError) as error:
        raise InputError(
            "truth.persisting_std is not zero, but the provenance has no valid world.radio, which says how the errors"
            " persist: the bound needs it (or drop truth.persisting_std to have all errors taken as white)"
        ) from error
    if "radio.technology" in config.code():
        raise InputError(
            f"the recording names code, radio.technology = '{config.technology}', which the bound needs: if you trust "
            f"it, give it again, --set radio.technology={config.technology}"
        )
    if not np.allclose(std[real], persisting_std(config), rtol=1e-6, atol=0.0):
        raise InputError(
            f"truth.persisting_std is not what the provenance's world.radio says ({persisting_std(config)} m, rad,"
            " rad): the bound needs both to agree"
        )
    return config


def turned(seen: Seen) -> Floats:
    """Return the change (n, 3, 3) of distance, azimuth and elevation per yaw, pitch and roll of the array.

    Units: m/rad (none) for distance, rad/rad for angles. First order in the turns, from the body-frame direction.
    """
    tangent = np.sin(seen.elevation_rad) / np.maximum(np.cos(seen.elevation_rad), 0.05)
    sine, cosine = np.sin(seen.azimuth_rad), np.cos(seen.azimuth_rad)
    out = np.zeros((len(sine), 3, 3))
    out[:, 1] = np.stack([-np.ones(len(sine)), tangent * sine, tangent * cosine], axis=1)
    out[:, 2, 1], out[:, 2, 2] = cosine, -sine
    return out


def runs(key: Ints, at: Floats, gap: float) -> tuple[Ints, int]:
    """Number the runs of rows (n,) with one `key` and no gap above `gap` in `at`: the run of each row, and how many."""
    order = np.lexsort((at, key))
    new = np.ones(len(key), np.bool_)
    new[1:] = (np.diff(key[order]) != 0) | (np.diff(at[order]) > gap)
    run = np.empty(len(key), np.int64)
    run[order] = np.cumsum(new) - 1
    return run, int(new.sum())


def _by_place(cause: Cause, seen: Seen, travelled_m: Floats) -> Part:
    """Return the states of a function of the distance (T,) along the drive, one for each VT and port, and component."""
    if cause.scale <= 0.0:
        return Part(np.full((len(seen.view_of), 3), -1), np.zeros(3), 0, BY_PLACE)
    entity, entities = runs(
        seen.vt * 4 + seen.port % 4, travelled_m[seen.snapshot[seen.view_of]], HOLD_SCALES * cause.scale
    )
    return Part(3 * entity[:, None] + np.arange(3), cause.std, 3 * entities, BY_PLACE)


def _by_vt(cause: Cause, seen: Seen, time_s: Floats) -> Part:
    """Return the states of a function of time, one for each VT and component."""
    views = len(seen.snapshot)
    if cause.scale <= 0.0:
        return Part(np.zeros((views, 3, 0), np.int32), np.zeros((views, 3, 0)), 0, BY_MERGING)
    vt = np.empty(views, np.int64)
    vt[seen.view_of] = seen.vt
    run, count = runs(vt, time_s[seen.snapshot], HOLD_SCALES * cause.scale)
    state = (3 * run[:, None, None] + np.arange(3)[:, None]).astype(np.int32)
    return Part(state, np.broadcast_to(cause.std[:, None], state.shape), 3 * count, BY_MERGING)


def _by_direction(cause: Cause, seen: Seen, time_s: Floats) -> Part:
    """Return the weights of a function of direction, for each component; its values at a view have unit length."""
    views = len(seen.snapshot)
    if cause.scale <= 0.0 or not cause.std.any() or views == 0:
        return Part(np.zeros((views, 3, 0), np.int32), np.zeros((views, 3, 0)), 0, 0)
    value = principal_functions(seen.direction, cause.scale)
    if value is not None:
        count = value.shape[1]
        function = np.tile(np.arange(count), (views, 1))
    else:
        cell, value = bell_functions(seen.azimuth_rad, seen.elevation_rad, cause.scale)
        function = np.full(cell.shape, -1)
        at = np.broadcast_to(time_s[seen.snapshot][:, None], cell.shape)[cell >= 0]
        function[cell >= 0], count = runs(cell[cell >= 0], at, HOLD_S)
    first, function = count * np.arange(3, dtype=np.int32)[:, None], function.astype(np.int32)
    state = np.where(function[:, None] >= 0, first + function[:, None], np.int32(-1))
    return Part(state, cause.std[:, None] * value[:, None], 3 * count, 0)


def principal_functions(direction: Floats, scale: float) -> Floats | None:
    """Return the values (n, K) of the principal functions at directions (n, 3); None where too many are needed.

    Eigenfunctions of the correlation under the density of the directions, by Nystrom's method on their cells.
    Directions are unit vectors, `scale` is a chord on the unit sphere, values are dimensionless.
    """
    cells, of, count = np.unique(np.round(direction / (0.4 * scale)), axis=0, return_inverse=True, return_counts=True)
    if len(cells) > 6 * MOST_FUNCTIONS:  # a function needs 2.5 to 4.5 of them (measured on six scenarios)
        return None
    centre = np.stack([np.bincount(of.reshape(-1), direction[:, i]) / count for i in range(3)], axis=1)
    root = np.sqrt(count / len(direction))
    value, vector = np.linalg.eigh(correlation(centre, centre, scale) * root[:, None] * root)
    missing = 1.0 - np.cumsum(value[::-1]) / value.sum()
    functions = int((missing > MISSING).sum()) + 1
    if functions > MOST_FUNCTIONS:
        return None
    weight = root[:, None] * vector[:, ::-1][:, :functions] / np.sqrt(value[::-1][:functions])
    blocks = np.array_split(direction, max(1, len(direction) // 4096))
    out = np.concatenate([correlation(block, centre, scale) @ weight for block in blocks])
    return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True), np.float64)


def correlation(a: Floats, b: Floats, scale: float) -> Floats:
    """Return exp(-chord^2 / (2 scale^2)) between unit vectors a (n, 3) and b (m, 3)."""
    square = np.maximum((a**2).sum(1)[:, None] + (b**2).sum(1) - 2.0 * a @ b.T, 0.0)
    return np.asarray(np.exp(-0.5 * square / scale**2), np.float64)


def bell_functions(azimuth_rad: Floats, elevation_rad: Floats, scale: float) -> tuple[Ints, Floats]:
    """Return the grid cells (n, W) around each direction, -1 for none, and the values (n, W) of their functions.

    Independent weights on bells exp(-chord^2 / scale^2), dense enough, make a field of correlation exp(-chord^2 / (2
    scale^2)).
    """
    step = SPACING * scale
    reach = np.arange(-2, 3)
    row = np.round(elevation_rad / step)[:, None] + reach
    sphere = np.abs(row * step) <= 0.5 * np.pi
    high = np.where(sphere, row * step, 0.0)
    around = np.maximum(np.round(2.0 * np.pi * np.cos(high) / step), 1.0)
    column = np.round(azimuth_rad[:, None] * around / (2.0 * np.pi))[:, :, None] + reach
    turn = azimuth_rad[:, None, None] - column * (2.0 * np.pi / around[:, :, None])
    flat = np.cos(elevation_rad)[:, None] * np.cos(high)
    square = 2.0 - 2.0 * (flat[:, :, None] * np.cos(turn) + (np.sin(elevation_rad)[:, None] * np.sin(high))[:, :, None])
    near: NDArray[np.bool_] = (square < (RADIUS * scale) ** 2) & (reach + 2 < around[:, :, None]) & sphere[:, :, None]
    value = np.where(near, np.exp(-square / scale**2), 0.0).reshape(len(row), -1)
    cell = (row[:, :, None] * np.ceil(8.0 / scale + 8.0) + column % around[:, :, None]).reshape(len(row), -1)
    order = np.argsort(-value, axis=1)[:, : int(near.reshape(len(row), -1).sum(1).max())]
    value = np.take_along_axis(value, order, axis=1)
    cell = np.where(value > 0.0, np.take_along_axis(cell, order, axis=1), np.inf)
    _, number = np.unique(cell, return_inverse=True)
    value /= np.linalg.norm(value, axis=1, keepdims=True)
    return np.where(value > 0.0, number.reshape(cell.shape), -1).astype(np.int64), value
