"""The odometry's data sheet: deviations by component, as `recording.toml` writes them and as a recording holds them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cellslam.recordings.importing.manifest import Noise
from cellslam.scenarios.problems import validate
from cellslam.sim.errors import InputError, nearest_name
from cellslam.sim.recording import COMPONENTS, OdometryModel

KINDS = tuple(Noise.model_fields)


def changed_sheet(sheet: OdometryModel, changes: Mapping[str, Any]) -> OdometryModel:
    """Return a data sheet in which `changes`, by "noise.COMPONENT.KIND" in m/s or rad/s, have their new values.

    Raises InputError naming the key and what is allowed.
    """
    columns = {kind: getattr(sheet, kind).copy() for kind in KINDS}
    for key, value in changes.items():
        _, _, rest = key.partition(".")
        component, _, kind = rest.partition(".")
        if component not in COMPONENTS:
            near = nearest_name(component, COMPONENTS)
            raise InputError(f"{key}: unknown component '{component}'{near} (known: {', '.join(COMPONENTS)})")
        checked = validate(Noise, {kind: value}, f"noise.{component}.")
        columns[kind][COMPONENTS.index(component)] = getattr(checked, kind)
    return OdometryModel(*(np.asarray(columns[kind], np.float64) for kind in KINDS))
