"""Raw responses of a drive: the recording's paths are found in them, by the reader of measured campaigns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellslam.recordings.adapters.tui_files import complex_of, opened
from cellslam.scenarios.loading import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.errors import InputError
from cellslam.sim.lte.signal.path_estimator.path_estimator import estimate_paths
from cellslam.sim.world import prepare
from cellslam.sim.world.responses import write_responses

FEW = {"radio.front_end": "signal", "vehicle.duration_s": 12.0, "vehicle.snapshot_interval_s": 1.0,
       "vehicle.distance_m": 4.0, "vehicle.stops": 0}  # fmt: skip


@pytest.mark.slow
def test_the_paths_of_the_recording_are_those_in_its_responses(tmp_path: Path) -> None:
    scenario = load("tiny", FEW)
    recording, signals = simulate(scenario, 3, 1), prepare(scenario.world, 3, 1).signals
    write_responses(tmp_path / "a.h5", scenario.world, 3, 1)
    assert [file.name for file in tmp_path.iterdir()] == ["a.h5"]
    assert signals is not None
    with opened(tmp_path / "a.h5", {}) as file:
        data, axes = file.dataset("FrequencyResponses/Data"), file.axes("FrequencyResponses/Data")
        assert axes == ("Snapshot", "Tx", "Rx", "Frequency")
        place = "FrequencyResponses/MetaData"
        np.testing.assert_array_equal(file.values(f"{place}/Snapshot/TimeStamp"), recording.time_s)
        assert data.shape[1:] == (len(recording.links), len(file.ports("FrequencyResponses", "Rx")), 200)
        sync_m, m = file.values(f"{place}/Tx/SyncDistance"), recording.measurements
        for t in (0, 7):
            motion = signals.receiver.moving(recording.odometry[t, :3])
            for link in range(len(recording.links)):
                found = estimate_paths(complex_of(data[t, link]).astype(np.complex64), motion)
                rows = (m.snapshot == t) & (m.link == link)
                assert rows.sum() == len(found)
                np.testing.assert_allclose(found.geometry[:, 0] + sync_m[link], m.distance_m[rows], atol=1e-3)
                np.testing.assert_allclose(found.geometry[:, 1], m.azimuth_rad[rows], atol=1e-4)


def test_responses_need_signals(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="front_end=signal"):
        write_responses(tmp_path / "a.h5", load("tiny").world, 0, 0)
