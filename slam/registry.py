"""Estimators by name: built-ins, entry points of other packages, or `module:Class`; loaded when asked for."""

from __future__ import annotations

import importlib
import re
import traceback
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

from cellslam.sim.errors import InputError, one_line, unknown_name
from cellslam.sim.own_code import seek_here

ENTRY_POINT_GROUP = "cellslam.estimators"
ALL = "all"
MOST_FRAMES = 6
_PLAIN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,59}")
_PACKAGES = Path(__file__).resolve().parent.parent  # where cellslam's own code is


class BrokenPluginError(InputError):
    """An estimator's own code fails when it is loaded: the fault of its author, not of the request."""


@dataclass(frozen=True)
class Listed:
    """An estimator that can be asked for: its name, where its class is, and one line about it.

    `needs`: a module that an extra of this name installs. `slow`: below five times real time on lund-530 with two
    cores, and left out of `all`. `oracle`: it is shown the truth. `external`: from another package.
    """

    name: str
    target: str
    summary: str
    needs: str = ""
    slow: bool = False
    oracle: bool = False
    external: bool = False


BUILT_IN = (
    Listed(
        "fastslam",
        "cellslam.slam.fastslam.fastslam:FastSlam",
        "particle filter over the path, Rao-Blackwellised, one gain for all particles; parts that can be replaced",
    ),
    Listed(
        "dead-reckoning",
        "cellslam.slam.dead_reckoning:DeadReckoning",
        "odometry alone, integrated from the start pose",
    ),
    Listed(
        "ekf-slam",
        "cellslam.slam.joint.ekf_slam:EkfSlam",
        "joint EKF of pose, odometry errors, clock offsets, VTs and errors that persist",
    ),
    Listed(
        "wall-slam",
        "cellslam.slam.joint.wall_slam:WallSlam",
        "EKF-SLAM whose VTs of several sites are images in walls that they share; maps the walls",
    ),
    Listed(
        "paper-fastslam",
        "cellslam.slam.fastslam.paper_fastslam:PaperFastSlam",
        "the paper's FastSLAM: bare Mahalanobis association, no clutter; yaw-rate bias and odometer scale marginalised",
    ),
    Listed(
        "bp-slam",
        "cellslam.slam.joint.bp_slam:BpSlam",
        "the joint filter of ekf-slam with association by belief propagation, on Gaussians",
    ),
    Listed(
        "phd-slam",
        "cellslam.slam.phd_slam.phd_slam:PhdSlam",
        "Rao-Blackwellised PHD filter: particles of the path, the map of each the intensity of a random finite set",
    ),
    Listed(
        "smoother",
        "cellslam.slam.smoother.smoother:Smoother",
        "factor graph over the whole drive with EKF-SLAM's associations; not causal",
        needs="gtsam",
    ),
    Listed(
        "oracle-association",
        "cellslam.slam.oracles:KnownAssociation",
        "EKF-SLAM that is given the true associations (oracle)",
        oracle=True,
    ),
    Listed(
        "oracle-fastslam",
        "cellslam.slam.oracles:FastSlamKnownAssociation",
        "FastSLAM that is given the true associations (oracle)",
        oracle=True,
    ),
    Listed(
        "oracle-map",
        "cellslam.slam.oracles:KnownMap",
        "localisation in the true map, clock offsets and associations unknown (oracle)",
        oracle=True,
    ),
)


def listing() -> tuple[Listed, ...]:
    """Return every estimator known by name, built-ins first, without importing any of them."""
    known = {entry.name: entry for entry in BUILT_IN}
    for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda p: p.name):
        package = point.dist.name if point.dist else point.module
        known.setdefault(point.name, Listed(point.name, point.value, f"from the package {package}", external=True))
    return tuple(known.values())


def names() -> tuple[str, ...]:
    """Return the names of `listing()`."""
    return tuple(entry.name for entry in listing())


def expanded(asked: Iterable[str]) -> tuple[str, ...]:
    """Return the names that were asked for, each once, `all` replaced by every known estimator that is fast enough."""
    every = [name for one in asked for name in ((n for n in names() if n not in left_out()) if one == ALL else (one,))]
    return tuple(dict.fromkeys(every))


def left_out() -> dict[str, str]:
    """Return the estimators that `all` leaves out, and why."""
    out = {}
    for entry in BUILT_IN:
        if entry.slow:
            out[entry.name] = "slower than 5 x real time"
        elif entry.needs and find_spec(entry.needs) is None:
            out[entry.name] = f"needs {entry.needs}: pip install 'cellslam[{entry.needs}]'"
    return out


def resolve(name: str) -> type[Any]:
    """Return the estimator class called `name`: a known name, or `module:Class`.

    For `module:Class` the current directory is appended to the import path, last. Raises InputError for an
    unknown name, module or class, and BrokenPluginError for a module that raises when it is imported, or what an
    installed package offers without being an estimator.
    """
    if ":" in name:
        seek_here()
        return _load(name, name)
    for entry in listing():
        if entry.name == name:
            try:
                return _load(name, entry.target)
            except InputError as error:
                raise BrokenPluginError(str(error)) from error
    raise _unknown(name)


def module_of(name: str) -> str | None:
    """Return the module of an external estimator, which runs in a process of its own; None for the others.

    cellslam's own are trusted. One that is defined in `__main__`, as in a notebook, is nowhere but in that process.
    """
    if ":" in name:
        module = name.partition(":")[0]
        return None if module in ("", "__main__") or module.startswith("cellslam.") else module
    known = (entry.target.partition(":")[0] for entry in listing() if entry.external and entry.name == name)
    return next(known, None)


def name_of(target: str, own_name: Any) -> str:
    """Return what an estimator is called in keys, rows, tables and figures.

    An estimator `module:Class` has the name in the attribute `name` of the class itself, not of a base of it, unless
    that is no plain name, or the name of an estimator that is known.
    """
    plain = isinstance(own_name, str) and _PLAIN_NAME.fullmatch(own_name)
    return own_name if ":" in target and plain and own_name not in names() else target


def options_model(estimator: type[Any]) -> type[Any] | None:
    """Return the pydantic model of an estimator's options: its class attribute `Options`, or None."""
    model: type[Any] | None = getattr(estimator, "Options", None)
    return model


def own_traceback(error: BaseException) -> str:
    """Return where an error came from, on one line, innermost last: frames of cellslam's runner and of the import
    machinery are left out, unless there are no others."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if "importlib" not in f.filename and not Path(f.filename).is_relative_to(_PACKAGES)]
    shown = own[-MOST_FRAMES:] or frames[-1:]
    return "".join(f" ({Path(f.filename).name}, line {f.lineno}, in {f.name})" for f in shown)


def _load(name: str, target: str) -> type[Any]:
    module_name, _, class_name = target.partition(":")
    if not (module_name and class_name):
        raise InputError(f"estimator '{name}': write module:Class, as in my_package.my_module:MyEstimator")
    module = _import(name, module_name)
    found = getattr(module, class_name, None)
    if found is None:
        classes = [n for n, v in vars(module).items() if isinstance(v, type) and n[0] != "_" and not _lacking(v)]
        raise unknown_name(f"class of module {module_name}", class_name, classes)
    lacking = _lacking(found)
    if not isinstance(found, type) or lacking:
        what = f"has no method '{lacking[0]}'" if lacking else "is not a class"
        raise InputError(f"estimator '{name}': {target} {what}; see cellslam.slam.api.Estimator")
    return found


def _lacking(estimator: Any) -> list[str]:
    return [method for method in ("start", "step") if not callable(getattr(estimator, method, None))]


def _import(name: str, module: str) -> ModuleType:
    try:
        return importlib.import_module(module)
    except BaseException as error:
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        if missing is not None and f"{module}.".startswith(f"{missing}."):
            text = f"there is no module '{missing}' in {Path.cwd()} or among the installed packages"
            raise InputError(f"estimator '{name}': {text}") from error
        text = f"its module cannot be imported: {type(error).__name__}: {one_line(error)}"
        raise BrokenPluginError(f"estimator '{name}': {text}{own_traceback(error)}") from error


def _unknown(name: str) -> InputError:
    error = unknown_name("estimator", name, names())
    return InputError(f"{error}; or give your own as module:Class")
