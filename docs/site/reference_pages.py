"""The pages of the reference that say what the code says: commands, keys, options, scenarios, the Python API.

Each function returns one page as Markdown; `site_hook.py` puts them into the site, tests hold them to the code.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Iterator
from importlib import import_module
from inspect import isclass

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

import cellslam
from cellslam.benchmarks.scores.metrics import COSTS, METRICS
from cellslam.cli.main import SECTIONS, build_parser, module_of
from cellslam.scenarios.keys import allowed, models_in, unit_of
from cellslam.scenarios.loading import load, preset_names
from cellslam.scenarios.scenario import Scenario
from cellslam.scenarios.suites import scenario_of, suite
from cellslam.slam import registry

NOT_KEYS = ("name", "title", "description", "facts", "estimator")
# The pages of Python: the public names of each, and, with a title, the modules that authors of estimators, adapters and
# experiments use besides.
PYTHON: dict[str, tuple[tuple[str, ...], dict[str, str]]] = {
    "running": (
        ("run", "trial", "TrialView", "replay", "sweep", "SweepView", "results", "summary", "comparison", "InputError"),
        {},
    ),
    "recordings": (
        ("simulate", "Recording", "plot", "windows"),
        {"Tables of a recording": "cellslam.sim.recording", "Campaigns, for adapters": "cellslam.recordings"},
    ),
    "estimators": (
        ("Estimator", "Setup", "Snapshot", "Estimate", "VtEstimate", "WallEstimate", "estimator_names", "VtMap",
         "join_maps", "Calibration"),
        {
            "Poses and frames": "cellslam.sim.frames",
            "The measurement model": "cellslam.slam.model.measurement_model",
            "Checks of an estimator": "cellslam.slam.conformance",
        },
    ),
    "worlds": (
        ("load", "preset_names", "Scenario", "trace"),
        {
            "Rays": "cellslam.sim.rays",
            "Reference signals of LTE": "cellslam.sim.lte",
            "Reference signals of NR": "cellslam.sim.nr",
        },
    ),
    "environments": ((), {"Python": "cellslam.benchmarks.env"}),
}  # fmt: skip
FACTS = {
    "paths_per_site": "paths per site and snapshot",
    "line_of_sight_share": "line of sight",
    "no_path_share": "no path",
    "distinct_vts": "VTs",
    "longest_reflected_s": "longest reflected, s",
    "measurements_per_snapshot": "measurements per snapshot",
}


def commands() -> str:
    """Return the page of all commands, read off their parsers."""
    lines = []
    for title, members in SECTIONS.items():
        lines += [f"## {title[0].upper()}{title[1:]}", ""]
        for name, summary in members.items():
            parser = _parser(name)
            lines += [f"### cellslam {name}", "", f"{summary[0].upper()}{summary[1:]}.", ""]
            lines += ["```text", parser.format_usage().removeprefix("usage: ").rstrip(), "```", ""]
            lines += [*_table(("argument", "meaning"), _arguments(parser)), ""]
            lines += ["```sh", *(f"cellslam {line}" for line in module_of(name).EXAMPLES), "```", ""]
    return "\n".join(lines)


def scenario_keys() -> str:
    """Return the page of all keys of a scenario, read off the models."""
    lines = []
    for name, field in Scenario.model_fields.items():
        if name not in NOT_KEYS:
            lines += [f"## {name}", "", f"{_sentence(field.description or '')}", ""]
            for model in models_in(field.annotation):
                lines += _several(models_in(field.annotation), model)
                lines += [*_table(_COLUMNS, _keys(model, f"{name}.NAME." if name == "sites" else f"{name}.")), ""]
    return "\n".join(lines)


def estimator_options() -> str:
    """Return the page of the options of all built-in estimators."""
    lines = []
    for entry in registry.BUILT_IN:
        lines += [f"## {entry.name}", "", _sentence(entry.summary), ""]
        if entry.needs:
            lines += [f"It needs `pip install 'cellslam[{entry.needs}]'`.", ""]
        else:
            options = registry.options_model(registry.resolve(entry.name))
            keys = _keys(options, f"estimator.{entry.name}.") if options else ()
            lines += [*_table(_COLUMNS, keys), ""] if options else ["It has no options.", ""]
    return "\n".join(lines)


def metrics() -> str:
    """Return the lines of a table: each metric of a row, with unit and meaning."""
    return "\n".join(
        f"| `{one.key}` | {one.meaning}{f', {one.unit}' if one.unit not in ('', 'time') else ''} |"
        for one in (*METRICS, *COSTS)
    )


def scenarios() -> str:
    """Return the page of the presets, with their measured facts."""
    found = [load(name) for name in preset_names()]
    rows = ((f"`{s.name}`", s.title, *(f"{s.facts.get(key, '')}" for key in FACTS)) for s in found)
    lines = [*_table(("preset", "what it is", *FACTS.values()), rows), ""]
    for scenario in found:
        lines += [f"## {scenario.name}", "", f"{_sentence(scenario.title)} {scenario.description.strip()}", ""]
    return "\n".join(lines)


def suites() -> str:
    """Return what is in the latest suite."""
    one = suite("standard")
    found = {name: scenario_of(one, name) for name in one.scenarios}
    rows = (
        (f"`{n}`", f"{one.trials_of(n)}", _sentence(s.title), " ".join(s.description.split())) for n, s in found.items()
    )
    return "\n".join(_table((f"scenario of `{one.name}`", "drives", "what it is", "what it is for"), rows))


def python(page: str) -> str:
    """Return the Python names of a page, for autodoc to fill."""
    names, modules = PYTHON[page]
    lines = []
    for name in names:
        lines += [f"## {name}", "", *_autodoc(home(name))]
    for title, module in modules.items():
        lines += [f"## {title}", "", f"The module `{module}`.", "", *_autodoc(module)]
    return "\n".join(lines)


def home(name: str) -> str:
    """Return where a public name of `cellslam` is defined, dotted."""
    value = getattr(cellslam, name)
    return f"{value.__module__}.{value.__qualname__}"


_COLUMNS = ("key", "default", "unit", "range", "meaning")


def _parser(name: str) -> argparse.ArgumentParser:
    """Return the parser of one command."""
    parser = build_parser(name.split())
    for word in name.split():
        chosen = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
        parser = chosen.choices[word]
    return parser


def _autodoc(name: str) -> list[str]:
    """Return the directive for a module, class or function; what stands elsewhere on the page is left out."""
    if any(name in modules.values() for _, modules in PYTHON.values()):
        more = ["   :exclude-members: Recording, ReferenceSignal"]
        return ["```{eval-rst}", f".. automodule:: {name}", *more, "```", ""]
    module, _, last = name.rpartition(".")
    kind = "class" if isclass(getattr(import_module(module), last)) else "function"
    return ["```{eval-rst}", f".. auto{kind}:: {name}", "```", ""]


def _arguments(parser: argparse.ArgumentParser) -> Iterator[tuple[str, str]]:
    for action in parser._actions:
        if action.help != argparse.SUPPRESS and action.dest != "help":
            value = action.metavar or ("{" + ",".join(map(str, action.choices)) + "}" if action.choices else "")
            value = " ".join(value) if isinstance(value, tuple) else value
            names = action.option_strings or [value]
            name = f"`{', '.join(names)}{f' {value}' if action.option_strings and action.nargs != 0 and value else ''}`"
            yield name, (action.help or "") % {"default": action.default, "prog": parser.prog}


def _keys(model: type[BaseModel], prefix: str) -> Iterator[tuple[str, ...]]:
    for name, field in model.model_fields.items():
        inner = models_in(field.annotation)
        several = "." if str(field.annotation).startswith("tuple") is False else ".N."
        for one in inner:
            yield from _keys(one, f"{prefix}{name}{several}")
        if not inner:
            default = field.get_default(call_default_factory=True, validated_data={})
            value = "" if default is PydanticUndefined else "none" if default is None else _plain(default)
            yield f"`{prefix}{name}`", value, unit_of(name), allowed(field), field.description or ""


def _several(models: list[type[BaseModel]], model: type[BaseModel]) -> list[str]:
    """Return what tells the models of a choice apart."""
    kind = model.model_fields.get("kind")
    return [f'With `kind = "{kind.default}"`:', ""] if len(models) > 1 and kind else []


def _plain(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, default=str)


def _sentence(text: str) -> str:
    text = text.strip()
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}"


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> list[str]:
    names = list(head)
    body = [" | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in row) for row in rows]
    return [f"| {' | '.join(names)} |", "|" + "---|" * len(names), *(f"| {row} |" for row in body)]
