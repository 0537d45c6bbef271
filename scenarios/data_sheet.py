"""What the receiver's data sheet says of measurement errors: options of estimators whose defaults are LTE's.

Of another waveform noise and diffuse energy disturb a path less or more; the rest is the array's and the car's.

Source: own, docs/explanation/front-end.md, "Other bandwidths".
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cellslam.sim.lte.persisting_errors import causes
from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.lte.single_path_bound import single_path_std
from cellslam.slam import registry

CAUSES = ("noise_unit_snr", "diffuse")
# What a linear filter makes of distances is not better than this: told of less, its covariance falls below its errors.
LEAST_DIFFUSE_M = 0.3


def data_sheet(radio: RadioConfig) -> dict[str, float]:
    """Return the options that the waveform decides: deviations in m and deg by noise at 0 dB, and by diffuse energy."""
    noise = single_path_std(0.0, waveform=radio.waveform())
    diffuse = next(cause.std for cause in causes(radio) if cause.name == "diffuse")
    out: dict[str, float] = {}
    for cause, (distance, *angles) in zip(CAUSES, (noise, diffuse), strict=True):
        azimuth, elevation = np.degrees(angles)
        values = {f"{cause}_m": distance, f"{cause}_azimuth_deg": azimuth, f"{cause}_elevation_deg": elevation}
        out.update(values)
    out["diffuse_m"] = max(out["diffuse_m"], LEAST_DIFFUSE_M)
    return {key: float(f"{value:.3g}") for key, value in out.items()}


def stated(radio: RadioConfig, tables: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return options of estimators by name, completed by the data sheet where the waveform is not LTE; what `tables`
    say themselves stands.
    """
    if radio.technology == "lte":
        return tables
    sheet, out = data_sheet(radio), dict(tables)
    for entry in registry.BUILT_IN:
        model = registry.options_model(registry.resolve(entry.name))
        known = {} if model is None else {key: value for key, value in sheet.items() if key in model.model_fields}
        if known:
            out[entry.name] = known | tables.get(entry.name, {})
    return out
