"""What an estimator answers: plain copies, the bytes that carry them to another process, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.errors import InputError, one_line
from cellslam.sim.recording import Floats, Recording
from cellslam.slam.api import Estimate, VtEstimate, WallEstimate
from cellslam.slam.model.calibration import Calibration

Columns = dict[str, NDArray[Any]]
MOST = 1e9  # metres, radians; a covariance has its square
MOST_RECORDS = 100_000  # VTs, walls
MOST_REMARKS, MOST_REMARK = 10, 400  # lines, characters
MOST_ID = 2**53
ROUNDING = 1e-6  # of a covariance's largest entry: what it may be asymmetric, or its eigenvalues negative
_NUMBERS = ("pose", "covariance", "clock_offset_m", "clock_offset_variance_m2")
# Maps: of what they are, and the shape of each column for one of it.
_MAPS: dict[str, tuple[type[VtEstimate] | type[WallEstimate], str, dict[str, tuple[int, ...]]]] = {
    "vts": (VtEstimate, "VT", {"id": (), "link": (), "position_m": (3,), "covariance": (3, 3), "scatterer": ()}),
    "walls": (
        WallEstimate, "wall",
        {"id": (), "azimuth_rad": (), "distance_m": (), "covariance": (2, 2), "extent_m": (2,)},
    ),
}  # fmt: skip
_CALIBRATION = ("size", "component", "cell", "mean", "covariance")
_WHOLE = frozenset(
    ("association", "vts.id", "vts.link", "vts.scatterer", "walls.id", "calibration.component", "calibration.cell")
)
_OPTIONAL = frozenset(("vts.scatterer",))
_SQUARES = frozenset(("covariance", "clock_offset_variance_m2", "vts.covariance", "walls.covariance"))


class BadAnswerError(ValueError):
    """An answer that breaks the contract of `slam.api`: wrong shape, not finite, or absurd."""


def plain(answer: Any) -> Columns:
    """Return copies of what an Estimate holds, by name, as 64-bit numbers; `vts` as `vts.id` and so on, `walls` alike.

    Raises BadAnswerError for anything but an Estimate of numbers, with whole numbers for ids.
    """
    if not isinstance(answer, Estimate):
        raise BadAnswerError(f"step returned {type(answer).__name__}, expected cellslam.slam.api.Estimate")
    given = {name: getattr(answer, name) for name in (*_NUMBERS, "association")}
    kept = {name: value for name, value in given.items() if value is not None or name in _NUMBERS[:2]}
    for key, (_, _, shapes) in _MAPS.items():
        if (known := getattr(answer, key)) is not None:
            columns = {f"{key}.{name}": getattr(known, name) for name in shapes}
            kept |= {name: column for name, column in columns.items() if name not in _OPTIONAL or column is not None}
    return {name: numbers(name, value) for name, value in kept.items()}


def plain_calibration(answer: Any) -> Columns:
    """Return copies of what a Calibration holds, by name. Raises BadAnswerError for anything else but None."""
    if answer is None:
        return {}
    if not isinstance(answer, Calibration):
        raise BadAnswerError(f"calibration() returned {type(answer).__name__}, expected cellslam.Calibration or None")
    of_grid = [answer.scale_rad, answer.spacing, answer.reach]
    given = {f"calibration.{name}": getattr(answer, name) for name in _CALIBRATION} | {"calibration.grid": of_grid}
    return {name: numbers(name, value) for name, value in given.items()}


def plain_remarks(answer: Any) -> list[str]:
    """Return what an estimator remarks, lines of text, as single lines. Raises BadAnswerError for anything else."""
    if not isinstance(answer, list | tuple) or not all(isinstance(line, str) for line in answer):
        raise BadAnswerError(f"remarks() returned {type(answer).__name__}, expected a list of lines of text")
    return [one_line(line, MOST_REMARK) for line in answer[:MOST_REMARKS]]


def calibration_of(answer: Columns) -> Calibration | None:
    """Return the Calibration that columns are of, checked; None where there is none. Raises BadAnswerError."""
    if "calibration.grid" not in answer:
        return None
    try:
        scale, spacing, reach = checked("calibration.grid", answer["calibration.grid"], (3,)).tolist()
        size, component, cell, mean, covariance = (answer[f"calibration.{name}"] for name in _CALIBRATION)
        calibration = Calibration(size, scale, spacing, reach, component, cell, mean, covariance)
        calibration.check()
    except (KeyError, InputError) as error:
        raise BadAnswerError(f"calibration: {error}") from error
    return calibration


def numbers(name: str, value: Any) -> NDArray[Any]:
    """Return a copy of one array of any shape, units unchanged, as float64, of ids as int64.

    Raises BadAnswerError where it holds something else.
    """
    array = np.array(value)
    if array.dtype.kind not in "iuf":
        raise BadAnswerError(f"{name} holds {array.dtype}, expected real numbers")
    if name not in _WHOLE:
        return array.astype(np.float64, copy=False)
    if not ((np.abs(array) <= MOST_ID) & (array == np.floor(array))).all():
        raise BadAnswerError(f"{name} holds more than whole numbers up to 2^53")
    return array.astype(np.int64, copy=False)


def encoded(header: Mapping[str, Any], columns: Columns) -> bytes:
    """Return a message: a line of JSON, then the arrays' bytes."""
    about = [[name, array.dtype.str, array.shape] for name, array in columns.items()]
    line = json.dumps({**header, "columns": about}).encode()
    return b"".join([line, b"\n", *(np.ascontiguousarray(array).tobytes() for array in columns.values())])


def decoded(message: bytes) -> tuple[dict[str, Any], Columns]:
    """Return header and arrays of a message, whoever wrote it. Raises ValueError where it is none."""
    line, _, rest = message.partition(b"\n")
    try:
        header = json.loads(line)
        columns, at = {}, 0
        for name, kind, shape in header["columns"]:
            if kind not in ("<f8", "<i8") or not all(type(n) is int and n >= 0 for n in shape):
                raise ValueError(kind)
            count = int(np.prod(shape, dtype=object))
            columns[str(name)] = np.frombuffer(rest, kind, count, at).reshape(shape)
            at += 8 * count
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise ValueError("not a message of this protocol") from error
    return header, columns


class Log:
    """The answers of a drive so far, checked; optional columns begin when the estimator first gives them."""

    def __init__(self, recording: Recording) -> None:
        self.rows, self.links, self.sites = recording.rows, len(recording.links), len(recording.sites)
        self.count = len(recording.time_s)
        self.columns: Columns = {}
        self.maps: dict[str, Any] = {}

    def add(self, t: int, answer: Columns) -> None:
        """Keep the answer of snapshot `t`."""
        part = slice(self.rows[t], self.rows[t + 1])
        sites = (self.sites,)
        shapes = {"pose": (6,), "covariance": (6, 6), "clock_offset_m": sites, "clock_offset_variance_m2": sites}
        for name, shape in (*shapes.items(), ("association", (part.stop - part.start,))):
            if name not in answer:
                continue
            array = checked(name, answer[name], shape)
            if name == "association":
                if (array < -1).any():
                    raise BadAnswerError(f"association holds {array.min()}, expected a VT's id, or -1 for none")
                self._column(name, (self.rows[-1],), -1)[part] = array
            else:
                self._column(name, (self.count, *shape), np.nan)[t] = array
        for key in _MAPS:
            if f"{key}.id" in answer:
                self.maps[key] = self._map(key, answer)

    def _column(self, name: str, shape: tuple[int, ...], empty: float) -> NDArray[Any]:
        """Return a column, made when it is first asked for."""
        if name not in self.columns:
            self.columns[name] = np.full(shape, empty)
        return self.columns[name]

    def check(self) -> None:
        """Raise BadAnswerError unless what was claimed over the drive can be variances and covariances."""
        check_covariances("covariance", self.columns["covariance"], "snapshot")
        variance = self.columns.get("clock_offset_variance_m2")
        if variance is not None and (variance < 0.0).any():
            raise BadAnswerError(
                f"clock_offset_variance_m2 holds {np.nanmin(variance):.6g}: a variance is not negative"
            )
        for key, known in self.maps.items():
            check_covariances(f"{key}.covariance", known.covariance, _MAPS[key][1])

    def _map(self, key: str, answer: Columns) -> VtEstimate | WallEstimate:
        """Return the VTs or walls of an answer, checked."""
        kind, of, shapes = _MAPS[key]
        count = answer[f"{key}.id"].size
        if count > MOST_RECORDS:
            raise BadAnswerError(f"{key} has {count} {of}s, the most are {MOST_RECORDS}")
        given = {n: f"{key}.{n}" for n in shapes if f"{key}.{n}" not in _OPTIONAL or f"{key}.{n}" in answer}
        columns = {n: checked(name, answer[name], (count, *shapes[n])) for n, name in given.items()}
        if key == "vts" and ((columns["link"] < 0) | (columns["link"] >= self.links)).any():
            raise BadAnswerError(f"vts.link has a link that is not one of the {self.links} links")
        if key == "walls" and (columns["extent_m"][:, 0] > columns["extent_m"][:, 1]).any():
            raise BadAnswerError("walls.extent_m has an end before its begin")
        return kind(**columns)


def checked(name: str, array: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return an array, units unchanged; raise BadAnswerError for another shape, or a value not finite or too large."""
    if array.shape != shape:
        raise BadAnswerError(f"{name} has shape {array.shape}, expected {shape}")
    most = MOST_ID if name in _WHOLE else MOST**2 if name in _SQUARES else MOST
    if not (np.abs(array) <= most).all():
        if np.isfinite(array).all():
            raise BadAnswerError(f"{name} holds {np.abs(array).max():.3g}, the most is {most:.3g}")
        raise BadAnswerError(f"{name} is not finite")
    return array


def check_covariances(name: str, stack: Floats, of: str) -> None:
    """Raise BadAnswerError unless all matrices (N, n, n) are symmetric, without negative eigenvalues, to rounding.

    In any units: rounding is relative to each matrix's largest element.
    """
    scale = np.abs(stack).max(axis=(1, 2), initial=0.0)
    skew = np.abs(stack - np.swapaxes(stack, 1, 2)).max(axis=(1, 2), initial=0.0)
    least = np.linalg.eigvalsh(stack)[:, 0]
    variance = np.diagonal(stack, axis1=1, axis2=2).min(axis=1)
    faults = {
        "is not symmetric": skew > ROUNDING * scale,
        "has a negative variance": variance < -1e-12 * scale,
        "has a negative eigenvalue": least < -ROUNDING * scale,
    }
    for what, wrong in faults.items():
        if wrong.any():
            raise BadAnswerError(f"{name} {what}, {of} {int(np.argmax(wrong))}")
