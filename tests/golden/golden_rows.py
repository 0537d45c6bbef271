"""The golden rows: what every deterministic estimator has on `tiny`, on the first 600 snapshots of `lund-530`, and on
its first 1200 with known clock offsets.

python tests/golden/golden_rows.py        measures them again and writes rows.json: say in the commit why they change
"""

from __future__ import annotations

import json
import platform
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import llvmlite.binding
import numpy as np

import cellslam
from cellslam.benchmarks.scores.metrics import COST_KEYS
from cellslam.sim.recording import Measurements, Recording, Truth

FILE = Path(__file__).with_name("rows.json")
SNAPSHOTS = 600
SHORT = "short"  # half of `tiny` with known clock offsets: there no estimator stands at a fork
DRIVES = (SHORT, "tiny", "lund-530", "known")


def short() -> Recording:
    """Return the drive on which differences in the last bits stay there."""
    return first(cellslam.simulate("tiny", overrides={"radio.clock_offset_std_m": 0.0}), 200)


def drives() -> dict[str, Recording]:
    """Return the recordings by name."""
    known = cellslam.simulate("lund-530", overrides={"radio.clock_offset_std_m": 0.0})
    unknown = cellslam.simulate("lund-530")
    made = short(), cellslam.simulate("tiny"), first(unknown, SNAPSHOTS), first(known, 2 * SNAPSHOTS)
    return dict(zip(DRIVES, made, strict=True))


def estimators() -> list[str]:
    """Return the built-in estimators that need no extra package: all of them are deterministic for a seed."""
    return [name for name in cellslam.estimator_names() if name != "smoother" and ":" not in name]


def rows(made: dict[str, Recording]) -> dict[str, dict[str, Any]]:
    """Return the row of each drive and estimator, times aside, by "drive estimator"."""
    found = {}
    for drive, recording in made.items():
        for row in cellslam.replay(recording, estimators()).to_dict("records"):
            kept = {key: value for key, value in row.items() if key not in COST_KEYS}
            found[f"{drive} {row['estimator']}"] = json.loads(json.dumps(kept, default=float).replace("NaN", "null"))
    return found


def versions() -> dict[str, str]:
    """Return what the last digits depend on: libraries, compiler, processor."""
    packages = {name: version(name) for name in ("numpy", "scipy", "numba", "llvmlite", "embreex")}
    processor = f"{llvmlite.binding.get_host_cpu_name()} {llvmlite.binding.get_host_cpu_features().flatten()}"
    return {**packages, "python": platform.python_version(), "processor": processor}


def first(recording: Recording, count: int) -> Recording:
    """Return the first `count` snapshots of a simulated recording."""
    rows = int(recording.rows[count])
    truth = recording.truth
    assert truth is not None
    visible = truth.vts.visible[truth.vts.visible[:, 1] < count].copy()
    visible[:, 2] = np.minimum(visible[:, 2], count - 1)
    persisting = None if truth.persisting_std is None else truth.persisting_std[:rows]
    shift = None if truth.merging_shift is None else truth.merging_shift[:rows]
    shorter = replace(
        truth, poses=truth.poses[:count], measurement_vt=truth.measurement_vt[:rows],
        measurement_std=truth.measurement_std[:rows], vts=replace(truth.vts, visible=visible),
        odometry_bias=truth.odometry_bias[:count], persisting_std=persisting, merging_shift=shift,
    )  # fmt: skip
    assert isinstance(shorter, Truth)
    m = recording.measurements
    columns = {name: None if value is None else value[:rows] for name, value in vars(m).items()}
    return replace(
        recording, time_s=recording.time_s[:count], odometry=recording.odometry[:count],
        measurements=Measurements(**columns), truth=shorter,
    )  # fmt: skip


if __name__ == "__main__":
    FILE.write_text(json.dumps({"versions": versions(), "rows": rows(drives())}, indent=1) + "\n", encoding="utf-8")
