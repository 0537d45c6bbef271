"""What estimators assume of a recording: options and the odometry's data sheet, given or learnt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from cellslam.recordings.fitting.fit_noise import shared, unmodelled
from cellslam.recordings.fitting.fit_sizes import Learnt, learn
from cellslam.recordings.importing.campaign import KINDS_OF_NOISE
from cellslam.recordings.importing.manifest import COMMANDS, Commands, Noise
from cellslam.scenarios import external_options
from cellslam.scenarios.estimator_options import Request
from cellslam.scenarios.keys import validate
from cellslam.scenarios.overrides import apply, split
from cellslam.scenarios.recording_origin import Origin
from cellslam.sim.errors import InputError, nearest_name
from cellslam.sim.lte.radio_config import NAMING, TECHNOLOGY
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import COMPONENTS, OdometryModel, Recording
from cellslam.slam.measurements.measurement_options import MeasurementOptions
from cellslam.slam.registry import expanded


@dataclass(frozen=True)
class Assumptions:
    """What estimators assume of a recording: their requests, with all options, and the odometry's data sheet.

    `learnt`: what the recording itself gave, None if it was not asked, or could not answer (`why`).
    """

    requests: tuple[Request, ...]
    odometry_model: OdometryModel
    learnt: Learnt | None = None
    why: str = ""

    @property
    def fitted(self) -> bool:
        """Whether the recording was asked, and may have answered."""
        return self.learnt is not None or bool(self.why)


def assumed(
    recording: Recording, origin: Origin, names: Sequence[str], given: Mapping[str, Any], fit: bool | None = None,
    progress: Progress = silent, limit_s: float = external_options.LOAD_LIMIT_S,
) -> Assumptions:  # fmt: skip
    """Return what estimators `names` assume: by the recording's scenario, or by what it shows itself (`fit`; None:
    for map builders on a measured one).

    `given`: what goes before, by key, "estimator.NAME.option" and "noise.COMPONENT.part"; `limit_s`: of
    `external_options.asking`. Raises InputError, also for code that the recording names and `given` does not.
    """
    _refuse_code(origin, names, given)
    overrides = {key: value for key, value in given.items() if not key.startswith("noise.")}
    sheet = changed_sheet(recording.odometry_model, {k: v for k, v in given.items() if k.startswith("noise.")})
    requests = _requests(origin.options, names, overrides, limit_s)
    if origin.measured:
        requests = _with(unmodelled(recording), origin, requests, overrides, limit_s)
    mapping = any(isinstance(r.options, MeasurementOptions) for r in requests)
    if not (origin.measured and mapping if fit is None else fit):
        return Assumptions(requests, sheet)
    try:
        learnt = learn(replace(recording, odometry_model=sheet), origin.assumed(), progress)
    except InputError as error:
        return Assumptions(requests, sheet, None, str(error))
    return Assumptions(_with(learnt.options, origin, requests, overrides, limit_s), learnt.odometry_model, learnt)


def _refuse_code(origin: Origin, names: Sequence[str], given: Mapping[str, Any]) -> None:
    """Raise InputError for code that would be loaded since the recording names it: a recording is data."""
    loaded = {*expanded(names), *(split(key)[1] for key in given if key.startswith("estimator."))}
    for key in origin.code:
        needed = key == TECHNOLOGY or (key not in NAMING and split(key)[1] in loaded)
        if needed and key not in given:
            raise InputError(origin.unasked(key))


def _with(
    options: Mapping[str, Any],
    origin: Origin,
    requests: Sequence[Request],
    overrides: Mapping[str, Any],
    limit_s: float,
) -> tuple[Request, ...]:
    """Return the requests with options of a front end, those that each estimator has."""
    merged = {
        r.name: {**origin.options.get(r.name, {}), **shared(options, type(r.options))}
        for r in requests
        if isinstance(r.options, MeasurementOptions)
    }
    return _requests({**origin.options, **merged}, [r.target for r in requests], overrides, limit_s)


def _requests(
    tables: Mapping[str, Any], names: Sequence[str], overrides: Mapping[str, Any], limit_s: float
) -> tuple[Request, ...]:
    full = apply({"estimator": tables}, overrides)["estimator"]
    return external_options.requests(full, names, overrides, limit_s)


def changed_sheet(sheet: OdometryModel, changes: Mapping[str, Any]) -> OdometryModel:
    """Return a data sheet in which `changes`, by "noise.COMPONENT.KIND" in m/s or rad/s, have their new values; so has
    "noise.commands.time_constant_s", in s.

    Raises InputError naming the key and what is allowed.
    """
    columns = {kind: getattr(sheet, kind).copy() for kind in KINDS_OF_NOISE}
    for key, value in changes.items():
        _, _, rest = key.partition(".")
        component, _, kind = rest.partition(".")
        if component == COMMANDS:
            commands = validate(Commands, {kind: value}, f"noise.{component}.")
            sheet = replace(sheet, time_constant_s=commands.time_constant_s)
            continue
        if component not in COMPONENTS:
            known = (*COMPONENTS, COMMANDS)
            near = nearest_name(component, known)
            raise InputError(f"{key}: unknown component '{component}'{near} (known: {', '.join(known)})")
        checked = validate(Noise, {kind: value}, f"noise.{component}.")
        columns[kind][COMPONENTS.index(component)] = getattr(checked, kind)
    return replace(sheet, **columns)
