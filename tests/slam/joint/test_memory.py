"""What bounds the memory of mixtures: fewer states, and wider components, each with a line that says so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from cellslam.sim.recording import Recording
from cellslam.slam.api import setup_of
from cellslam.slam.joint import mixture, start
from cellslam.slam.joint.ekf_slam import EkfSlam
from tests.slam.driving import driven

Toy = Callable[..., Recording]


def test_a_full_state_takes_in_no_more_and_says_so(toy_recording: Toy, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = toy_recording(40)
    assert recording.truth is not None
    sites = replace(
        recording.sites, clock_offset_mean_m=recording.truth.clock_offsets_m, clock_offset_std_m=np.zeros(2)
    )
    recording = replace(recording, sites=sites)
    free = EkfSlam()
    driven(free, recording)
    assert free._joint is not None and free.remarks() == [] and free._joint.arrays.size[0, 0] > 60
    monkeypatch.setattr("cellslam.slam.joint.ekf_slam.MOST_STATES", 60)
    monkeypatch.setattr(mixture, "MOST_BYTES", 8.0 * 60**2)
    one = EkfSlam()
    answers = driven(one, recording)
    assert one._joint is not None and one._joint.arrays.p.shape == (1, 60, 60)
    assert one._joint.arrays.size[0, 0] == 60 and np.isfinite(answers[-1].pose).all()
    assert any("the state is full" in line for line in one.remarks())


@pytest.mark.slow
def test_uncertain_clocks_take_wider_components_rather_than_more(toy_recording: Toy) -> None:
    recording = toy_recording()
    sites = replace(recording.sites, clock_offset_std_m=np.full(2, 3e4))
    one = EkfSlam()
    one.start(setup_of(replace(recording, sites=sites)), np.random.default_rng(0))
    assert one._start is not None and 500 < sum(map(len, one._start.mixtures)) <= start.MOST_FILTERS + 2
    assert sum(8.0 * len(m) * m._most_states**2 for m in one._start.mixtures) <= mixture.MOST_BYTES
    assert any("components of 188 m, not 20 m" in line for line in one.remarks())
    few = EkfSlam()
    few.start(setup_of(recording), np.random.default_rng(0))
    assert few.remarks() == []
