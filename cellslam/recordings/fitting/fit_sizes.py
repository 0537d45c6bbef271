"""Sizes of all errors as a whole drive shows them: EKF-SLAM goes through it again and again, with what it learnt.

Every cause k of errors has a size s_k: white noise, errors that persist, the odometry. A pass gives the slope g_k of
the log-likelihood, and of what was assumed, in log s_k and its information I_k; the next pass is a step nearer to the
likeliest (`slam.joint.sizes.stepped`):

    g_k = d log p(z | s) / d log s_k,    log s_k <- log s_k + share / 2 log(1 + 2 g_k / I_k)

with share 1 in the first WHOLE passes, 1/2 in the others, and half of it where the drive has no answer to the sizes.
The result are the sizes that fit best, of a pass whose slopes are the drive's own chance: mean of g_k^2 / I_k < FITS.
They are taken where, and only where, they predict what is measured later better than the defaults do (`held_out`).
So is the time constant with which a vehicle follows its commands, before them, where odometry is what it was commanded.

Sources: Shumway and Stoffer, "An approach to time series smoothing and forecasting using the EM algorithm", Journal of
Time Series Analysis 3(4), 1982; Breiman, Friedman, Olshen and Stone, Classification and Regression Trees, 1984, section
3.4 (within one deviation of the best); `slam.joint.sizes` has those of the steps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellslam.recordings.fitting.fit_noise import initial_options, known_to, unmodelled
from cellslam.recordings.fitting.held_out import Worth, compared, scores
from cellslam.recordings.importing.campaign import KINDS_OF_NOISE
from cellslam.recordings.importing.manifest import COMMANDS
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import COMPONENTS, Floats, OdometryModel, Recording
from cellslam.slam import registry
from cellslam.slam.api import setup_of, steps_of
from cellslam.slam.joint import sizes
from cellslam.slam.joint.ekf_slam import EkfSlam
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from cellslam.slam.joint.sizes import Sheets, Sizes, keys_of, stepped
from cellslam.slam.measurements.measurement_options import MeasurementOptions

PASSES, WHOLE = 5, 2  # passes at most; so many take whole steps, the others half of them
FITS = 2.0  # mean square of the slopes, in their deviations, from which on sizes are as good as right
NOTABLE = 1.25  # factor by which a size must have changed to be reported
LEAST_SURE = 0.5  # relative deviation of a size beyond which the size is not reported
# A pass joins the mixtures of the start after so long at the latest, s: sizes show also where an offset is wrong yet,
# and where all are assumed far too large none is ever resolved.
START_LIMIT_S = 150.0
# Slip of a real vehicle comes in bursts: a filter that assumes the deviation over the whole drive is too sure in these.
BURSTS = 3.0
# Bias and scale that any odometer may have, m/s and rad/s: what a data sheet leaves out cannot be learnt.
LEAST_BIAS, LEAST_SCALE = {"u_psi": 1e-3}, {"u_x": 0.01, "u_psi": 0.01}
# With which a vehicle may follow its commands, s, of small robots to lorries; then factors of the best of these.
TIME_CONSTANTS_S, BETWEEN = (0.1, 0.2, 0.4, 0.8, 1.6), (2.0**-0.5, 2.0**0.5)


@dataclass(frozen=True)
class Learnt:
    """What was learnt: `options` that all map builders share, by name, and the odometry's data sheet.

    `changes`: by what factor a size of `slam.joint.sizes.OPTIONS` differs from what was assumed, and its relative
    standard deviation; what the drive does not tell is left out, and stays as assumed. `worth`: how much better what
    was learnt predicts than the defaults; None where clock offsets never were resolved, so that nothing was learnt.
    Where it is not surely better, options and data sheet are the defaults, and the worth is that of the best rival.
    """

    options: dict[str, Any]
    odometry_model: OdometryModel
    changes: dict[str, tuple[float, float]]
    worth: Worth | None


def learn(recording: Recording, assumed: Mapping[str, Any] | None, progress: Progress = silent) -> Learnt:
    """Return the sizes that a recording shows, or the defaults where these predict as well.

    `assumed`: front-end options to begin with, by name; None: nobody modelled this front end, and the tracks of its
    measurements give them. Raises InputError where these are too few to tell.
    """
    sheet = recording.odometry_model
    default = Learnt(dict(unmodelled(recording) if assumed is None else assumed), sheet, {}, None)
    followed = default
    if sheet.time_constant_s == 0.0:
        followed = replace(default, odometry_model=_followed(recording, default, progress))
    recording = replace(recording, odometry_model=followed.odometry_model)
    with progress("learning the sizes of errors", PASSES) as advance:
        fitted = _fitted(recording, assumed, advance)
    if fitted is None:
        return default
    # What is learnt of the odometry is taken beside what is learnt of measurements, or not.
    changes = {name: change for name, change in fitted.changes.items() if name not in COMPONENTS}
    rivals = [default, replace(fitted, odometry_model=followed.odometry_model, changes=changes), fitted]
    if followed is not default and followed.odometry_model.time_constant_s:
        rivals.append(followed)
    options, found = [EkfSlamOptions(**one.options) for one in rivals], list[Floats]()
    with progress("comparing what was learnt with the defaults", len(rivals)) as advance:
        for one, own in zip(rivals, options, strict=True):
            found.append(scores(recording, Sheets(own, one.odometry_model), options))
            advance(1)
    worth = [compared(found[0], own) for own in found]
    best = max(range(1, len(rivals)), key=lambda i: (worth[i].sure, worth[i].mean))
    return replace(rivals[best if worth[best].sure else 0], worth=worth[best])


def _followed(recording: Recording, default: Learnt, progress: Progress) -> OdometryModel:
    """Return the data sheet of commands with the least time constant that predicts what is measured later as well as
    the best one, within one deviation (Breiman et al. 1984), if that is surely better than that the vehicle follows at
    once. Too great a one predicts nearly as well, and errs more."""
    options, found = EkfSlamOptions(**default.options), dict[float, Floats]()

    def try_out(time_constants_s: Sequence[float]) -> float:
        with progress("learning how the vehicle follows commands", len(time_constants_s)) as advance:
            for tau in time_constants_s:
                sheet = replace(default.odometry_model, time_constant_s=tau)
                found[tau] = scores(recording, Sheets(options, sheet), [options])
                advance(1)
        return max(found, key=lambda tau: compared(found[0.0], found[tau]).mean)

    best = try_out((0.0, *TIME_CONSTANTS_S))
    best = try_out([best * factor for factor in BETWEEN]) if best else 0.0
    behind = {tau: compared(own, found[best]) for tau, own in found.items() if tau > 0.0}
    least = min((tau for tau, worth in behind.items() if worth.mean <= worth.std), default=0.0)
    sure = least > 0.0 and compared(found[0.0], found[least]).sure
    return replace(default.odometry_model, time_constant_s=least if sure else 0.0)


def _fitted(recording: Recording, assumed: Mapping[str, Any] | None, advance: Callable[[int], None]) -> Learnt | None:
    """Return the sizes that fit best; None where clock offsets are never resolved."""
    sheet, bursts = recording.odometry_model, 1.0
    if assumed is None:
        assumed, sheet, bursts = initial_options(recording), _with_least(recording, sheet), BURSTS
    first = tried = Sheets(EkfSlamOptions(**{"start_limit_s": START_LIMIT_S} | dict(assumed)), sheet)
    last: Pass | None = None
    fitting: Pass | None = None
    share = 1.0
    for number in range(PASSES):
        found = _found(recording, tried)
        advance(1)
        if found is not None:
            share = 1.0 if number < WHOLE else 0.5
            nearer, off = stepped(tried, found, first, share)
            last = Pass(tried, found, off)
            fitting = last if fitting is None or off < fitting.off else fitting
            if off < FITS:
                advance(PASSES - 1 - number)  # no more are needed
                break
            tried = nearer
        elif last is None:
            return None
        else:
            share *= 0.5
            tried, _ = stepped(last.sheets, last.found, first, share)
    assert fitting is not None
    options, odometry = fitting.sheets
    noise = recording.odometry_model.noise_density
    ratio = np.divide(odometry.noise_density, noise, out=np.ones(6), where=noise > 0.0)
    changes = {
        name: (_factor(name, first.options, options, ratio), deviation)
        for name, deviation in fitting.found.deviations().items()
        if deviation < LEAST_SURE
    }
    was, now = first.options.model_dump(), options.model_dump()
    shared = {key: value for key, value in sorted(now.items()) if key in assumed or value != was[key]}
    return Learnt(shared, _safe(odometry, fitting.found, bursts), changes, None)


class Pass(NamedTuple):
    """A pass through the drive: what the filter assumed, what it found, and how far off that says these are."""

    sheets: Sheets
    found: Sizes
    off: float


def _found(recording: Recording, sheets: Sheets) -> Sizes | None:
    """Return what ekf-slam finds of sizes on a drive; None: clock offsets are never resolved."""
    # What is counted for paths that merge makes other errors of angles look smaller than they are, and what is counted
    # for slip those of the odometry; and slopes are to be against the sheets, not against diffuse errors that grow.
    estimator = EkfSlam(sheets.options.model_copy(update={"merge_rate": 0.0, "slip_probability": 0.0}))
    estimator.grows = False
    recording = replace(recording, odometry_model=sheets.odometry)
    estimator.start(setup_of(recording), np.random.default_rng(0))
    for step in steps_of(recording):
        estimator.step(*step)
    try:
        return estimator.sizes()
    except RuntimeError:
        return None


def _safe(sheet: OdometryModel, found: Sizes, bursts: float) -> OdometryModel:
    """Return a data sheet to be assumed, of one that was likely: as wide as it must be where slip comes in bursts, with
    no wider bias and scale than the drive shows."""
    return replace(
        sheet,
        noise_density=bursts * sheet.noise_density,
        bias=np.fmin(sheet.bias, BURSTS * np.sqrt(found.bias)),
        scale=np.fmin(sheet.scale, BURSTS * np.sqrt(found.scale)),
    )


def _factor(name: str, first: EkfSlamOptions, now: EkfSlamOptions, odometry: Floats) -> float:
    """Return by what factor a size has changed."""
    if name in COMPONENTS:
        return float(odometry[COMPONENTS.index(name)])
    key = max(keys_of(name), key=lambda key: float(getattr(first, key)))
    return float(getattr(now, key) / getattr(first, key))


def _with_least(recording: Recording, sheet: OdometryModel) -> OdometryModel:
    """Return a data sheet with a bias and a scale for each velocity that is measured."""
    bias, scale = sheet.bias.copy(), sheet.scale.copy()
    for values, least in ((bias, LEAST_BIAS), (scale, LEAST_SCALE)):
        for name, value in least.items():
            i = COMPONENTS.index(name)
            if not np.isnan(recording.odometry[:, i]).all():
                values[i] = max(values[i], value)
    return replace(sheet, bias=bias, scale=scale)


def toml(path: Path, learnt: Learnt) -> str:
    """Return the tables [estimator.NAME] and [noise.COMPONENT] that `--options` takes, for every estimator that has
    these options; comments say where from."""
    import tomli_w

    comments = [f"learnt from {path}; cellslam replay takes this file as --options FILE.toml", *in_words(learnt)]
    models = {entry.name: registry.options_model(registry.resolve(entry.name)) for entry in registry.BUILT_IN}
    options = {key: _rounded(value) for key, value in learnt.options.items()}
    own = {
        name: known_to(model, options)
        for name, model in models.items()
        if options and model is not None and issubclass(model, MeasurementOptions)
    }
    sheet, noise = learnt.odometry_model, dict[str, dict[str, Any]]()
    if sheet.time_constant_s:
        noise[COMMANDS] = {"time_constant_s": _rounded(sheet.time_constant_s)}
    for i, component in enumerate(COMPONENTS):
        values = {kind: _rounded(float(getattr(sheet, kind)[i])) for kind in KINDS_OF_NOISE}
        noise |= {component: values} if any(values.values()) else {}
    tables = {"estimator": own, "noise": noise}
    text = tomli_w.dumps({name: table for name, table in tables.items() if table})
    return "".join(f"# {line}\n" for line in comments) + "\n" + text


def in_words(learnt: Learnt) -> list[str]:
    """Return lines that say what differs from what was assumed."""
    if learnt.worth is None:
        return ["sizes of errors as assumed: the clock offsets were never resolved, so nothing could be learnt"]
    if not learnt.worth.sure:
        return [f"kept the defaults: what was learnt does not surely predict better than they do ({learnt.worth})"]
    time_constant_s = learnt.odometry_model.time_constant_s
    lines = [f"the vehicle follows its commands with {time_constant_s:.2g} s"] if time_constant_s else []
    lines += [
        f"{sizes.in_words(name)}: {factor:.2g} times as large as assumed (+- {100.0 * deviation:.0f} %)"
        for name, (factor, deviation) in learnt.changes.items()
        if not 1.0 / NOTABLE < factor < NOTABLE
    ]
    begin = f"sizes of errors, as the whole drive shows them ({learnt.worth})"
    return [f"{begin}:", *(f"  {line}" for line in lines)] if lines else [f"{begin}, are about those that were assumed"]


def _rounded(value: Any) -> Any:
    return float(f"{value:.4g}") if isinstance(value, float) else value
