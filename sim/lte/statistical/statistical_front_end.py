"""Statistical front end: what the receiver's path estimator would report, drawn from its statistics.

Per link and path: received power, interference, SNR, overlap with stronger paths, detection, error from the
bound and the floors, in part white and in part persisting; then clutter. The constants are measured (`statistics`).

Source: own derivation, docs/explanation/front-end.md, "Statistical front end".
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import chndtr

from cellslam.sim.lte.error_bounds import bound_scales
from cellslam.sim.lte.links import Cells, link_table
from cellslam.sim.lte.persisting_errors import floors, white_floors
from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.lte.statistical import detector_layout as k
from cellslam.sim.lte.statistical.detector_layout import PathColumns, Streams
from cellslam.sim.lte.statistical.measurement_kernel import Fields
from cellslam.sim.lte.statistical.statistics import Statistics, statistics_of
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Floats, Ints, Measurements

BLOCK = 512  # snapshots per kernel call: the step of the progress bar


@dataclass(frozen=True)
class Detections:
    """Measurements, and of each the path row that it came from (-1 clutter), its true deviations (M, 3), of white and
    persisting errors together, and what merged paths moved it by (M, 3); NaN for clutter and where it is not known.
    """

    measurements: Measurements
    path: Ints
    true_std: Floats
    merging_shift: Floats


def noise_clutter_mean(threshold: float, s: Statistics) -> float:
    """Return the mean number of noise peaks per link and snapshot over a threshold x: N exp(-x) (1 + x)."""
    return float(s.noise_cells * np.exp(-threshold) * (1.0 + threshold))


@lru_cache(maxsize=8)
def detection_table(threshold: float, s: Statistics) -> Floats:
    """Return the detection probability (1201,) of an isolated path over the kernel's grid of Gamma in dB.

    P(T <= x) is the distribution function of a noncentral chi-square at 2 x, of dof degrees of freedom and
    noncentrality gain Gamma, at the threshold x; dof and gain are measured.
    """
    gamma_db = k.TABLE_START_DB + k.TABLE_STEP_DB * np.arange(1201)
    # scipy.stats has it, too, and takes a second to load.
    missed = chndtr(2.0 * threshold, s.dof, s.gain * 10.0 ** (gamma_db / 10.0))
    return np.clip(1.0 - missed, 0.0, 1.0)


@lru_cache(maxsize=8)
def model_of(config: RadioConfig, s: Statistics) -> k.Model:
    """Return the kernel's constants for a radio configuration."""
    scales, diffuse = bound_scales(config.waveform()), 10.0 ** (-config.specular_to_diffuse_db / 10.0)
    clutter = s.clutter_at(config.specular_to_diffuse_db)
    return k.Model(
        budget=k.Budget(
            eirp_mw=10.0 ** (config.eirp_dbm / 10.0), noise_mw=config.noise_mw(), load=config.load,
            evm_power=config.evm**2, snr_cap=10.0 ** (config.snr_cap_db / 10.0), samples=float(scales.samples),
        ),
        accuracy=k.Accuracy(
            bound=k.Spread(scales.distance_m, scales.azimuth_rad, scales.elevation_rad),
            floor=k.Spread(*floors(config, s).tolist()), white=k.Spread(*white_floors(config, s).tolist()),
            scale=config.noise_scale,
        ),
        detection=k.Detection(
            threshold=config.detection_threshold, isolated=detection_table(config.detection_threshold, s),
            scale=config.detection_scale, perfect=config.perfect_detection,
            window_min_m=config.window_min_m, window_max_m=config.window_max_m,
        ),
        overlap=k.Overlap(
            centre_db=s.overlap_centre_db, width_db=s.overlap_width_db,
            ghost_share=10.0 ** (-config.ghost_rule_db / 10.0), trail=s.trail * diffuse, around=s.around * diffuse,
            sidelobes=s.sidelobes, sidelobe_m=s.sidelobe_m,
        ),
        clutter=k.ClutterModel(
            noise_peaks=noise_clutter_mean(config.detection_threshold, s) * config.clutter_scale,
            mean=clutter.mean * config.clutter_scale, points=clutter.points, blur_m=s.blur_m,
            company=s.company_at(config.specular_to_diffuse_db),
        ),
        standing=s.standing if config.persisting_clutter else k.NOTHING_STANDS,
    )  # fmt: skip


def detect(
    config: RadioConfig, cells: Cells, paths: PathColumns, poses: Floats, offsets_m: Floats, fields: Fields,
    streams: Streams, first_snapshot: int = 0, progress: Progress = silent, constants: Statistics | None = None,
) -> Detections:  # fmt: skip
    """Return the measurements of `poses` (T, 6), in m and rad, whose paths are `paths`, numbered from `first_snapshot`.

    `offsets_m` (S,) is added to the distances; `fields` are the errors that persist (`persisting_errors.draw_fields`).
    The streams advance: a drive in one call or pose by pose gives the same. What stands still depends on how the stream
    of clutter was seeded, not on what was drawn from it. `constants`: other than the shipped ones.
    """
    from cellslam.sim.lte.statistical.detection_kernel import measure_block

    links = link_table(cells)
    s = constants or statistics_of(config, asked=True)
    world = streams.clutter.bit_generator.seed_seq.generate_state(1, np.uint64)[0]
    model = model_of(config, s)
    model = model._replace(standing=model.standing._replace(world=world))
    out = [np.empty((0, k.COLUMNS))]
    with progress("measuring", len(poses)) as advance:
        for start in range(0, len(poses), BLOCK):
            part = poses[start : start + BLOCK]
            own, low = paths.of_snapshots(start, start + len(part), len(offsets_m))
            away = own.departure_rad[:, :1] - cells.azimuth_rad, own.departure_rad[:, 1:]
            sector = 10.0 ** (0.1 * config.sector_gain_db(*away, cells.tilt_rad))
            block = measure_block(
                first_snapshot + start, np.ascontiguousarray(part, np.float64), own, sector,
                np.asarray(offsets_m, np.float64), links, model, fields, streams,
            )  # fmt: skip
            block[:, k.PATH] += np.where(block[:, k.PATH] >= 0, low, 0)
            out.append(block)
            advance(len(part))
    return detections_of(np.concatenate(out))


def detections_of(table: Floats) -> Detections:
    """Return the detections in a table (M, COLUMNS), m, rad, dB, as the kernels write it."""
    c = np.ascontiguousarray(table.T)
    measurements = Measurements(
        snapshot=c[k.SNAPSHOT].astype(np.int64), link=c[k.LINK].astype(np.int64), distance_m=c[k.DISTANCE],
        azimuth_rad=c[k.AZIMUTH], elevation_rad=c[k.ELEVATION], snr_db=c[k.SNR_DB],
        distance_std_m=c[k.CLAIMED_STD], azimuth_std_rad=c[k.CLAIMED_STD + 1],
        elevation_std_rad=c[k.CLAIMED_STD + 2],
    )  # fmt: skip
    path = c[k.PATH].astype(np.int64)
    std, shift = (np.ascontiguousarray(c[first : first + 3].T) for first in (k.TRUE_STD, k.MERGING_SHIFT))
    return Detections(measurements, path, std, shift)
