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
from cellslam.sim.lte.radio_config import NAMING, RadioConfig
from cellslam.sim.own_code import FILES, allow, is_allowed
from cellslam.sim.recording import Recording


@dataclass(frozen=True)
class Origin:
    """Where a recording comes from, by its provenance; that of a `measured` one has no scenario.

    `code`: what it names of code that is not cellslam's and was not loaded, and of files that were not read, by key;
    without that of its world there is no `scenario`.
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
    def of(recording: Recording, path: Path = Path("recording"), given: Mapping[str, Any] | None = None) -> Origin:
        """Read the provenance of a recording; one without a name is called as the file `path` is.

        `given`: keys of the user; those `NAMING` allow to load the code, and to read the file, that the recording
        names there. Raises InputError where it names another, or it cannot be loaded.
        """
        provenance = recording.provenance
        tables, own = provenance.get("scenario"), _named(provenance)
        for key in NAMING:
            if given and key in given:
                if given[key] != own[key]:
                    raise InputError(
                        f"{key}={given[key]}: a recording is as it is, with '{own[key]}'; leave the key out"
                    )
                allow(key, own[key])
        unloaded = {key: name for key, name in own.items() if not is_allowed(key, name)}
        seed, trial = _count(provenance.get("seed")), _count(provenance.get("trial"))
        if not isinstance(tables, Mapping):
            return Origin(path.stem, seed, trial, {}, None, True, unloaded)
        scenario, options = None, tables.get("estimator")
        options = options if isinstance(options, Mapping) else {}
        if not unloaded:
            # One of another version of the models: estimators need its options only, not its world.
            with suppress(InputError):
                scenario = from_tables(tables, code=False)
        name = str(tables.get("name", path.stem))
        return Origin(name, seed, trial, options, scenario, False, {**unloaded, **own_code(options)})

    def unasked(self, key: str) -> str:
        """Return what `code` of a key is not used for, and how it would be."""
        name = self.code[key]
        what = "a file" if key in FILES else "code"
        return (
            f"the recording names {what}, {key} = '{name}', which is not loaded unasked; if you trust it, give it "
            f"again: --set {key}={name}"
        )


def _named(provenance: Mapping[str, Any]) -> dict[str, str]:
    """Return what a provenance says of the keys `NAMING`, their defaults where it says nothing."""
    tables = (provenance.get("scenario"), provenance.get("world"))
    radios = (one.get("radio") for one in tables if isinstance(one, Mapping))
    radio = next((one for one in radios if isinstance(one, Mapping)), {})
    fields = {key: key.removeprefix("radio.") for key in NAMING}
    return {key: str(radio.get(name) or RadioConfig.model_fields[name].default or "") for key, name in fields.items()}


def _count(value: Any) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) and value >= 0 else 0
