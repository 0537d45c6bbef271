"""Options of estimators: the scenario's tables, validated by each estimator's own model.

In another band than LTE's 20 MHz they begin with what the receiver's data sheet says: noise and diffuse energy disturb
a path less or more there; the rest is the array's and the car's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel, create_model

from cellslam.scenarios.keys import validate
from cellslam.scenarios.overrides import split
from cellslam.sim.errors import InputError, unknown_name
from cellslam.slam import registry

if TYPE_CHECKING:
    from cellslam.scenarios.scenario import Scenario
    from cellslam.sim.lte.radio_config import RadioConfig

Tables = Mapping[str, Mapping[str, Any]]
# Asks an estimator, by its module, its target and tables of options, for its name, all of its options, and whether it
# is an oracle.
Ask = Callable[[str, str, Tables], tuple[str, Mapping[str, Any] | None, bool]]
CAUSES = ("noise_unit_snr", "diffuse")


@dataclass(frozen=True)
class Request:
    """An estimator that was asked for: its name, its class, and its validated options (None: it has none).

    `external`: it is loaded and run in a process of its own alone; `estimator` only says whether it is an oracle.
    `module_class`: where its class is found, as module:Class, if it was asked for so and has a name of its own.
    """

    name: str
    estimator: type[Any]
    options: BaseModel | None
    external: bool = False
    module_class: str = ""

    @property
    def target(self) -> str:
        """What it is loaded by: module:Class, or a name that is known."""
        return self.module_class or self.name

    @property
    def oracle(self) -> bool:
        """Whether it is shown the truth."""
        return bool(getattr(self.estimator, "requires_truth", False))


def resolve(
    tables: Tables, names: Sequence[str], overrides: Iterable[str] = (), ask: Ask | None = None
) -> tuple[Request, ...]:
    """Return the requests for estimators `names`, each once, in their order; `all` stands for every one that is known.

    An estimator whose own code fails when it is loaded is a request too: it raises when it is run. `tables` are a
    scenario's options by estimator; `overrides` are the dotted keys that the user set: they are validated also for
    estimators not in `names`. `ask`: external estimators are not loaded here, but asked by it
    (`external_options.asking`). Raises InputError for an unknown estimator or option, or a value out of range.
    """
    requests = tuple(_request(tables, name, ask) for name in registry.expanded(names))
    asked = called(requests)
    _check_names(requests)
    known = {*registry.names(), *asked}
    for name in tables:
        if name not in known and ":" not in name:
            raise unknown_name("table", f"estimator.{name}", (f"estimator.{k}" for k in known))
    touched = {split(key)[1] for key in overrides if key.startswith("estimator.")}
    for name in sorted(touched - asked):
        _request(tables, name, ask)
    return requests


def called(requests: Iterable[Request]) -> set[str]:
    """Return all that estimators may be called in keys: as they were asked for, and what their classes call
    themselves."""
    return {text for request in requests for text in (request.name, request.target)}


def _check_names(requests: Iterable[Request]) -> None:
    seen: dict[str, str] = {}
    for request in requests:
        other = seen.setdefault(request.name, request.target)
        if other != request.target:
            text = f"{other} and {request.target} are both called '{request.name}'"
            raise InputError(f"{text}: give each class an attribute `name` of its own")


def external_request(name: str, options: Mapping[str, Any] | None, oracle: bool, module_class: str = "") -> Request:
    """Return the request for an estimator that runs in a process of its own; `options` are all of its options."""
    stand_in = type("External", (), {"requires_truth": oracle})
    if options is None:
        return Request(name, stand_in, None, True, module_class)
    fields: dict[str, Any] = {key: (Any, value) for key, value in options.items()}
    model: Any = create_model("Options", **fields)
    return Request(name, stand_in, model(), True, module_class)


def with_options(scenario: Scenario, requests: Iterable[Request]) -> Scenario:
    """Return `scenario` with every option of the requested estimators written out, defaults included."""
    full = {r.target: r.options.model_dump(mode="json") for r in requests if r.options is not None}
    others = {name: table for name, table in scenario.estimator.items() if name not in {r.name for r in requests}}
    return scenario.model_copy(update={"estimator": {**others, **full}})


def option_keys() -> list[str]:
    """Return the dotted keys of the options of all built-in estimators."""
    models = {entry.name: registry.options_model(registry.resolve(entry.name)) for entry in registry.BUILT_IN}
    return [f"estimator.{name}.{key}" for name, model in models.items() if model for key in model.model_fields]


def own_code(tables: Tables) -> dict[str, str]:
    """Return the code, module:name, that options of built-in estimators name, by dotted key, as parts of FastSLAM."""
    names = [entry.name for entry in registry.BUILT_IN if isinstance(tables.get(entry.name), Mapping)]
    options = ((name, key, value) for name in names for key, value in tables[name].items())
    return {
        f"estimator.{name}.{key}": value
        for name, key, value in options
        if isinstance(value, str) and ":" in value and not key.endswith("_file")
    }


def loaded(target: str, tables: Tables) -> Request:
    """Return the request for an estimator that is loaded in this process: by a name that is known, or as module:Class.

    Its options stand in the table of its name or of its target. Raises InputError, BrokenPluginError.
    """
    estimator = registry.resolve(target)
    name = registry.name_of(target, vars(estimator).get("name"))
    table = {**tables.get(target, {}), **tables.get(name, {})}
    model = registry.options_model(estimator)
    if model is None and table:
        raise InputError(f"unknown key 'estimator.{name}.{next(iter(table))}': estimator '{name}' has no options")
    options = None if model is None else validate(model, table, f"estimator.{name}.")
    return Request(name, estimator, options, module_class="" if name == target else target)


def broken(reason: InputError) -> type[Any]:
    """Return a class in the place of an estimator that cannot be loaded: making one raises the reason."""

    class Broken:
        def __init__(self, options: Any) -> None:
            del options
            raise reason

    return Broken


def _request(tables: Tables, target: str, ask: Ask | None) -> Request:
    module = None if ask is None else registry.module_of(target)
    try:
        if ask is None or module is None:
            return loaded(target, tables)
        own_name, options, oracle = ask(module, target, tables)
        name = registry.name_of(target, own_name)
        return external_request(name, options, oracle, "" if name == target else target)
    except registry.BrokenPluginError as error:
        return Request(target, broken(error), None)


def data_sheet(radio: RadioConfig) -> dict[str, float]:
    """Return the options that the waveform decides: deviations in m and deg by noise at 0 dB, and by diffuse energy."""

    from cellslam.sim.lte.error_bounds import single_path_std
    from cellslam.sim.lte.persisting_errors import causes

    noise = single_path_std(0.0, waveform=radio.waveform())
    diffuse = next(cause.std for cause in causes(radio) if cause.name == "diffuse")
    out: dict[str, float] = {}
    for cause, (distance, *angles) in zip(CAUSES, (noise, diffuse), strict=True):
        azimuth, elevation = np.degrees(angles)
        values = {f"{cause}_m": distance, f"{cause}_azimuth_deg": azimuth, f"{cause}_elevation_deg": elevation}
        out.update(values)
    return {key: float(f"{value:.3g}") for key, value in out.items()}


def stated(radio: RadioConfig, tables: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return options of estimators by name, completed by the data sheet where the waveform is not LTE of 20 MHz, whose
    sheet is their defaults; what `tables` say themselves stands.
    """
    if (radio.technology, radio.resource_blocks) == ("lte", 100):
        return tables
    sheet, out = data_sheet(radio), dict(tables)
    for entry in registry.BUILT_IN:
        if entry.needs:  # may not be installed
            continue
        model = registry.options_model(registry.resolve(entry.name))
        known = {} if model is None else {key: value for key, value in sheet.items() if key in model.model_fields}
        if known:
            out[entry.name] = known | tables.get(entry.name, {})
    return out
