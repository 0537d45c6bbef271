"""What an answer must look like: the checks of one Estimate, used by the conformance kit."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from cellslam.sim.recording import Floats
from cellslam.slam.api import Estimate, Setup, Snapshot


class ConformanceError(AssertionError):
    """Something that an estimator does wrong; the text says what, and what to do about it."""


def finding(what: str, remedy: str) -> ConformanceError:
    """Return the error that says what is wrong and how to fix it."""
    return ConformanceError(f"{what}; to fix: {remedy}")


def require(ok: bool, what: str, remedy: str) -> None:
    """Raise ConformanceError unless `ok`."""
    if not ok:
        raise finding(what, remedy)


def require_same(a: Sequence[Estimate], b: Sequence[Estimate], what: str, remedy: str) -> None:
    """Raise ConformanceError where two series of answers differ, in any bit."""
    for t, (x, y) in enumerate(zip(a, b, strict=True)):
        for field in fields(Estimate):
            same = pickle.dumps(_plain(getattr(x, field.name))) == pickle.dumps(_plain(getattr(y, field.name)))
            require(same, f"{what} ({field.name} of snapshot {t})", remedy)


def _plain(value: Any) -> Any:
    """Return plain data that compare and pickle by value."""
    if value is None or isinstance(value, (int, float)):
        return value
    if isinstance(value, (np.ndarray, list, tuple)):
        array = np.asarray(value)
        return array.dtype.str, array.shape, array.tobytes()
    return tuple(_plain(getattr(value, field.name)) for field in fields(value))


def check_answer(answer: Any, snapshot: Snapshot, setup: Setup) -> None:
    """Raise ConformanceError unless a step has answered with an Estimate of the right shapes, all finite."""
    what = f"step returned {type(answer).__name__}"
    require(isinstance(answer, Estimate), what, "return cellslam.slam.api.Estimate(pose, covariance)")
    check_array("pose", answer.pose, (6,))
    check_array("covariance", answer.covariance, (6, 6))
    sites = (len(setup.sites),)
    for name, shape in (("clock_offset_m", sites), ("clock_offset_variance_m2", sites)):
        if getattr(answer, name) is not None:
            check_array(name, getattr(answer, name), shape)
    if answer.association is not None:
        check_array("association", answer.association, (len(snapshot),))
        ids = np.asarray(answer.association)
        proper = np.issubdtype(ids.dtype, np.integer) and bool((ids >= -1).all())
        require(proper, "association holds more than whole numbers from -1", "give a VT's id, or -1 for none")
    if answer.vts is not None:
        count = len(answer.vts.id)
        check_array("vts.link", answer.vts.link, (count,))
        check_array("vts.position_m", answer.vts.position_m, (count, 3))
        check_array("vts.covariance", answer.vts.covariance, (count, 3, 3))
    if answer.walls is not None:
        count = len(answer.walls)
        check_array("walls.azimuth_rad", answer.walls.azimuth_rad, (count,))
        check_array("walls.distance_m", answer.walls.distance_m, (count,))
        check_array("walls.covariance", answer.walls.covariance, (count, 2, 2))
        check_array("walls.extent_m", answer.walls.extent_m, (count, 2))


def check_array(name: str, value: Any, shape: tuple[int, ...]) -> None:
    """Raise ConformanceError unless `value` has this shape and is finite."""
    array = np.asarray(value)
    require(array.shape == shape, f"{name} has shape {array.shape}", f"its shape is {shape}")
    finite = np.issubdtype(array.dtype, np.number) and bool(np.isfinite(array).all())
    require(finite, f"{name} is not finite", "guard divisions and logarithms; skip what was not measured")


def check_covariance(what: str, matrix: Floats, remedy: str) -> None:
    """Raise ConformanceError unless a matrix (n, n) is symmetric without negative eigenvalues.

    In any units: to 1e-9 of its largest element.
    """
    scale = max(float(np.abs(matrix).max()), 1e-12)
    require(float(np.abs(matrix - matrix.T).max()) <= 1e-9 * scale, f"{what} is not symmetric", remedy)
    least = float(np.linalg.eigvalsh(matrix)[0])
    require(least >= -1e-9 * scale, f"{what} has the eigenvalue {least:.3g}", remedy)
