"""cellslam: simulate cellular multipath SLAM, run estimators on it, and score them.

The first ten minutes, in a notebook:

    import cellslam
    cellslam.run("tiny", ["fastslam", "dead-reckoning"], trials=2)      # a pandas table, a row a trial
    cellslam.trial("tiny", "ekf-slam").plot("map")                      # one trial: figures, truth, estimates
    recording = cellslam.simulate("tiny", seed=1)                       # what was measured, and the truth
    cellslam.replay(recording, "fastslam")                              # estimators on one recording
    cellslam.sweep("tiny", {"radio.load": [0.0, 0.5]}, "results/load").table()  # variants, in parallel, resumed
    for batch in cellslam.windows("learn-lund", 64, 32): ...            # drives of a set, to learn from

`cellslam --help` has the same as commands. Everything is loaded when it is first used.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cellslam.benchmarks.sweeps.rows import results
    from cellslam.benchmarks.tables.summaries import comparison, summary
    from cellslam.python_api import SweepView, TrialView, replay, run, sweep, trial
    from cellslam.recordings.inspection.inspection import plot
    from cellslam.scenarios.loading import load, preset_names
    from cellslam.scenarios.scenario import Scenario
    from cellslam.scenarios.sets.windows import windows
    from cellslam.scenarios.simulation import simulate
    from cellslam.sim.errors import InputError
    from cellslam.sim.rays.tracing import trace
    from cellslam.sim.recording import Recording
    from cellslam.slam.api import Estimate, Estimator, Setup, Snapshot, VtEstimate, WallEstimate
    from cellslam.slam.model.calibration import Calibration
    from cellslam.slam.model.map_joining import join_maps
    from cellslam.slam.model.vt_map import VtMap
    from cellslam.slam.registry import names as estimator_names

    __version__: str

_NAMES = {
    "benchmarks.sweeps.rows": ("results",),
    "benchmarks.tables.summaries": ("comparison", "summary"),
    "recordings.inspection.inspection": ("plot",),
    "python_api": ("SweepView", "TrialView", "replay", "run", "sweep", "trial"),
    "scenarios.loading": ("load", "preset_names"),
    "scenarios.scenario": ("Scenario",),
    "scenarios.sets.windows": ("windows",),
    "scenarios.simulation": ("simulate",),
    "sim.errors": ("InputError",),
    "sim.rays.tracing": ("trace",),
    "sim.recording": ("Recording",),
    "slam.api": ("Estimate", "Estimator", "Setup", "Snapshot", "VtEstimate", "WallEstimate"),
    "slam.model.calibration": ("Calibration",),
    "slam.model.map_joining": ("join_maps",),
    "slam.model.vt_map": ("VtMap",),
    "slam.registry": ("estimator_names",),
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}
__all__ = [
    "Calibration", "Estimate", "Estimator", "InputError", "Recording", "Scenario", "Setup", "Snapshot", "SweepView",
    "TrialView", "VtEstimate", "VtMap", "WallEstimate", "__version__", "comparison", "estimator_names", "join_maps",
    "load", "plot", "preset_names", "replay", "results", "run", "simulate", "summary", "sweep", "trace", "trial",
    "windows",
]  # fmt: skip

if sys.platform == "win32":
    raise ImportError("cellslam runs on Linux and macOS; on Windows, in the Windows Subsystem for Linux (WSL)")


def __getattr__(name: str) -> Any:
    """Load a name when it is first asked for (PEP 562): `import cellslam` stays light."""
    if name == "__version__":
        from importlib.metadata import version

        found: Any = version("cellslam")
    elif name in _HOMES:
        own_name = "names" if name == "estimator_names" else name
        found = getattr(import_module(f"{__name__}.{_HOMES[name]}"), own_name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
