"""What estimators assume of a recording: options and the odometry's data sheet, given or learnt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pydantic import BaseModel

from cellslam.recordings.fitting.fit_noise import known_to, unmodelled
from cellslam.recordings.fitting.fit_sizes import Learnt, learn
from cellslam.recordings.importing.campaign import KINDS_OF_NOISE
from cellslam.recordings.importing.manifest import COMMANDS, Commands, Noise
from cellslam.scenarios import external_options
from cellslam.scenarios.estimator_options import Request
from cellslam.scenarios.keys import validate
from cellslam.scenarios.overrides import apply, split
from cellslam.scenarios.recording_origin import Origin
from cellslam.sim.errors import InputError, unknown_name
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

    def requested(shared: Mapping[str, Any], map_builders: Mapping[str, type[BaseModel]]) -> tuple[Request, ...]:
        """Return the requests, those of `map_builders` with options that these share, as far as their models have
        them."""
        merged = {
            name: {**origin.options.get(name, {}), **known_to(model, shared)} for name, model in map_builders.items()
        }
        tables = apply({"estimator": {**origin.options, **merged}}, overrides)["estimator"]
        return external_options.requests(tables, names, overrides, limit_s)

    requests = requested({}, {})
    mapping = {r.name: type(r.options) for r in requests if isinstance(r.options, MeasurementOptions)}
    if origin.measured:
        requests = requested(unmodelled(recording), mapping)
    if not (origin.measured and mapping if fit is None else fit):
        return Assumptions(requests, sheet)
    try:
        learnt = learn(replace(recording, odometry_model=sheet), origin.assumed(), progress)
    except InputError as error:
        return Assumptions(requests, sheet, None, str(error))
    return Assumptions(requested(learnt.options, mapping), learnt.odometry_model, learnt)


def _refuse_code(origin: Origin, names: Sequence[str], given: Mapping[str, Any]) -> None:
    """Raise InputError for code that would be loaded since the recording names it: a recording is data."""
    loaded = {*expanded(names), *(split(key)[1] for key in given if key.startswith("estimator."))}
    for key in origin.code:
        needed = key == TECHNOLOGY or (key not in NAMING and split(key)[1] in loaded)
        if needed and key not in given:
            raise InputError(origin.unasked(key))


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
            raise unknown_name(f"component in {key}:", component, (*COMPONENTS, COMMANDS))
        checked = validate(Noise, {kind: value}, f"noise.{component}.")
        columns[kind][COMPONENTS.index(component)] = getattr(checked, kind)
    return replace(sheet, **columns)
