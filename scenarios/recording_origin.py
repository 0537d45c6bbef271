"""What a recording says of its origin: scenario, root seed, trial."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cellslam.scenarios.loading import from_tables
from cellslam.scenarios.scenario import Scenario
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording


@dataclass(frozen=True)
class Origin:
    """What a recording says about where it comes from; a `measured` one says nothing of a scenario."""

    name: str
    seed: int
    trial: int
    options: Mapping[str, Any]
    scenario: Scenario | None
    measured: bool = False

    def assumed(self) -> Mapping[str, Any] | None:
        """Return the options of ekf-slam that a simulated recording has; None: nobody modelled its front end."""
        return None if self.measured else self.options.get("ekf-slam", {})

    @staticmethod
    def of(recording: Recording, path: Path = Path("recording")) -> Origin:
        """Read the provenance of a recording; one that says nothing is called as the file `path` is."""
        said = recording.provenance
        tables = said.get("scenario")
        if not isinstance(tables, Mapping):
            return Origin(path.stem, _count(said.get("seed")), _count(said.get("trial")), {}, None, True)
        try:
            scenario = from_tables(tables)
        except InputError:
            # Written by another version of the models: estimators need its options only, not its world.
            scenario = None
        name, options = str(tables.get("name", path.stem)), tables.get("estimator", {})
        return Origin(name, _count(said.get("seed")), _count(said.get("trial")), options, scenario)


def _count(value: Any) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) and value >= 0 else 0
