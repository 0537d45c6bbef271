"""The origin of a recording: scenario, root seed, trial. Provenance is data: no code that it names is loaded."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cellslam.scenarios.estimator_options import own_code
from cellslam.scenarios.loading import from_tables
from cellslam.scenarios.scenario import Scenario
from cellslam.sim.errors import InputError
from cellslam.sim.own_code import is_loaded, load_own
from cellslam.sim.recording import Recording

TECHNOLOGY = "radio.technology"


@dataclass(frozen=True)
class Origin:
    """Where a recording comes from, by its provenance; that of a `measured` one has no scenario.

    `code`: what it names of code that is not cellslam's and was not loaded, by key; without that of its world there is
    no `scenario`.
    """

    name: str
    seed: int
    trial: int
    options: Mapping[str, Any]
    scenario: Scenario | None
    measured: bool = False
    code: Mapping[str, str] = field(default_factory=dict)

    def assumed(self) -> Mapping[str, Any] | None:
        """Return the options of ekf-slam that a simulated recording has; None: nobody modelled its front end."""
        return None if self.measured else self.options.get("ekf-slam", {})

    @staticmethod
    def of(recording: Recording, path: Path = Path("recording"), technology: Any = None) -> Origin:
        """Read the provenance of a recording; one without a name is called as the file `path` is.

        `technology`: the recording's waveform, given again by the user, which allows to load its code.
        Raises InputError where it is another, or cannot be loaded.
        """
        provenance = recording.provenance
        tables, own = provenance.get("scenario"), _technology(provenance)
        if technology not in (None, own):
            raise InputError(f"{TECHNOLOGY}={technology}: a recording is as it is, with '{own}'; leave the key out")
        if technology is not None and ":" in own:
            load_own(TECHNOLOGY, own)
        unloaded = {} if is_loaded(own) else {TECHNOLOGY: own}
        seed, trial = _count(provenance.get("seed")), _count(provenance.get("trial"))
        if not isinstance(tables, Mapping):
            return Origin(path.stem, seed, trial, {}, None, True, unloaded)
        scenario, options = None, tables.get("estimator")
        options = options if isinstance(options, Mapping) else {}
        if not unloaded:
            # One of another version of the models: estimators need its options only, not its world.
            with suppress(InputError):
                found = from_tables(tables, code=False)
                scenario = None if found.radio.code() else found
        name = str(tables.get("name", path.stem))
        return Origin(name, seed, trial, options, scenario, False, {**unloaded, **own_code(options)})


def _technology(provenance: Mapping[str, Any]) -> str:
    """Return the waveform that a provenance names."""
    for tables in (provenance.get("scenario"), provenance.get("world")):
        radio = tables.get("radio") if isinstance(tables, Mapping) else None
        if isinstance(radio, Mapping):
            return str(radio.get("technology", "lte"))
    return "lte"


def _count(value: Any) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) and value >= 0 else 0
