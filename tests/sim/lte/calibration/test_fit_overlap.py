"""The law of crowded paths, fitted: at least as likely as the law that the detections were drawn from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellslam.sim.lte.calibration.fit_constants import fit_overlap
from cellslam.sim.lte.calibration.overlap import Law, chances, relations
from cellslam.sim.lte.calibration.scenes import Sample, config_of, measured_by_statistics, scenes_of
from cellslam.sim.waveform import Waveform

RATIOS_DB = (3.0, 6.0, 15.0)
DETECTION, THRESHOLD = {"dof": 13.0, "gain": 1.6}, 17.4


def chances_of(samples: dict[float, Sample], waveform: Waveform, law: Law) -> dict[float, np.ndarray]:
    detection = DETECTION["dof"], DETECTION["gain"]
    return {r: chances(s, relations(s, waveform), r, detection, THRESHOLD, law) for r, s in samples.items()}


def log_likelihood(samples: dict[float, Sample], chance: dict[float, np.ndarray]) -> float:
    clipped = {r: np.clip(c, 1e-3, 1.0 - 1e-3) for r, c in chance.items()}
    return sum(float(np.log(np.where(s.detected, clipped[r], 1.0 - clipped[r])).sum()) for r, s in samples.items())


@pytest.mark.parametrize(
    "law",
    [
        pytest.param(Law(8.0, 3.4, -0.1, -2.1, -0.95, 13.5), id="in its direction, sidelobes near"),
        pytest.param(Law(8.2, 3.2, -1.2, -2.5, -1.9, 150.0), id="in all directions, sidelobes far"),
    ],
)
def test_the_fit_is_at_least_as_likely_as_the_law_it_was_drawn_from(law: Law) -> None:
    rng, samples = np.random.default_rng(8), {}
    for ratio in RATIOS_DB:
        config = config_of(ratio)
        samples[ratio] = measured_by_statistics(config, scenes_of(rng, 250, config), rng)
    waveform = config_of(6.0).waveform()
    truth = chances_of(samples, waveform, law)
    samples = {r: replace(s, detected=rng.random(len(s.link)) < truth[r]) for r, s in samples.items()}
    f = fit_overlap(samples, DETECTION, THRESHOLD, waveform)
    found = chances_of(samples, waveform, Law(
        f["centre_db"], f["width_db"], *np.log10([f["trail"], f["around"], f["sidelobes"]]), f["sidelobe_m"]
    ))  # fmt: skip
    assert log_likelihood(samples, found) > log_likelihood(samples, truth) - 0.5
    for ratio in RATIOS_DB:
        assert np.sqrt(np.mean((found[ratio] - truth[ratio]) ** 2)) < 0.02
