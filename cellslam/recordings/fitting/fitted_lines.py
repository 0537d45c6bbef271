"""What was learnt of a recording's errors, as a file for `--options` and as lines to read."""

from __future__ import annotations

from pathlib import Path

from cellslam.recordings.fitting.fit_sizes import Learnt
from cellslam.sim.recording import COMPONENTS
from cellslam.slam import registry
from cellslam.slam.joint.sizes import in_words

NOTABLE = 1.25  # factor by which a size must have changed to be said


def toml(path: Path, learnt: Learnt) -> str:
    """Return the tables [estimator.NAME] and [noise.COMPONENT] that `--options` takes, for every estimator that has
    these options; comments say where from."""
    out = [f"# learnt from {path}; cellslam replay takes this file as --options FILE.toml"]
    out += [f"# {line}" for line in said(learnt)]
    tables = {e.name: learnt.table(registry.options_model(registry.resolve(e.name))) for e in registry.BUILT_IN}
    for name, table in tables.items():
        if table:
            out += ["", f"[estimator.{name}]", *(f"{key} = {_value(value)}" for key, value in table.items())]
    sheet = learnt.odometry_model
    for i, component in enumerate(COMPONENTS):
        values = {kind: getattr(sheet, kind)[i] for kind in ("noise_density", "bias", "bias_walk_density", "scale")}
        if any(values.values()):
            out += ["", f"[noise.{component}]", *(f"{kind} = {value:.4g}" for kind, value in values.items())]
    return "\n".join(out) + "\n"


def said(learnt: Learnt) -> list[str]:
    """Return lines that say what differs from what was assumed."""
    if not learnt.resolved:
        return ["sizes of errors as assumed: the clock offsets were never resolved, so nothing could be learnt"]
    lines = [
        f"{in_words(name)}: {factor:.2g} times as large as assumed (+- {100.0 * deviation:.0f} %)"
        for name, (factor, deviation) in learnt.changes.items()
        if not 1.0 / NOTABLE < factor < NOTABLE
    ]
    begin = "sizes of errors, as the whole drive shows them"
    return [f"{begin}:", *(f"  {line}" for line in lines)] if lines else [f"{begin}, are those that were assumed"]


def _value(value: float | str) -> str:
    return f'"{value}"' if isinstance(value, str) else f"{value:.4g}"
