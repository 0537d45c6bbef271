"""Measure the facts of presets with the ray tracer, and write them into their files."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

import numpy as np
import tomli_w

from cellslam.cli.arguments import DONE
from cellslam.scenarios.loading import PRESETS, load, preset_names
from cellslam.scenarios.scenario import Scenario
from tools.scenario_facts import scenario_facts

TRIALS = 10
"""Trials whose mean is written down for a scenario that draws another place in each trial."""
NOTE = "# Measured with the ray tracer by `python -m tools preset-facts`."


def mean_facts(scenario: Scenario) -> dict[str, float]:
    """Return the facts of trial 0 of root seed 0, or their mean over trials where the place is drawn."""
    trials = TRIALS if getattr(scenario.city, "seed", 0) == "trial" else 1
    facts = [scenario_facts(scenario.world, 0, trial).rounded() for trial in range(trials)]
    return {name: round(float(np.mean([f[name] for f in facts])), 2) for name in facts[0]}


def write_facts(path: Path, facts: dict[str, float]) -> None:
    """Replace the table [facts], the last one of the preset at `path`, or append it."""
    text = path.read_text("utf-8").split(NOTE)[0].rstrip()
    table = tomli_w.dumps({"facts": {name: _number(value) for name, value in facts.items()}})
    path.write_text(f"{text}\n\n{NOTE}\n{table}", "utf-8")


def _number(value: float) -> float:
    return int(value) if value == int(value) else value


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this tool."""
    parser.add_argument("names", metavar="NAME", nargs="*", help="presets (default: all)")


def command(arguments: Namespace) -> int:
    """Measure the presets of these names, or all."""
    for name in arguments.names or preset_names():
        facts = mean_facts(load(name))
        write_facts(PRESETS / f"{name}.toml", facts)
        print(f"{name}: {facts}")
    return DONE
