"""The viewer's other contents: a recording played back, a city with rays, and the folder of a run."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellslam.benchmarks.report.city_page import MOST_RAYS, write_city
from cellslam.benchmarks.report.playback import content
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.sweeps.rows import results
from cellslam.cli.main import main
from cellslam.scenarios.loading import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.rays import trace
from cellslam.sim.rays.exchange import Traced
from cellslam.sim.rays.paths import DIFFRACTED
from cellslam.sim.recording import Recording
from cellslam.sim.world import prepare
from cellslam.slam.api import VtEstimate

pytest.importorskip("plotly", reason="extra report")
SHORT = {"vehicle.distance_m": 5.0, "vehicle.duration_s": 8.0, "vehicle.stops": 0}


def true_result(recording: Recording) -> TrialResult:
    truth = recording.truth
    assert truth is not None
    offsets = np.tile(truth.clock_offsets_m, (len(recording.time_s), 1))
    covariances = np.tile(np.eye(6), (len(recording.time_s), 1, 1))
    return TrialResult("toy", truth.poses, covariances, clock_offset_m=offsets)


def test_playback_has_the_city_and_paths_that_point_to_their_transmitters() -> None:
    recording = simulate("tiny", 3, 0, {**SHORT, "radio.load": 0.0})
    (section,) = content(recording, true_result(recording))["trials"]
    scene, truth, m = section["scene"], recording.truth, recording.measurements
    assert truth is not None and scene["city"] == "city" and scene["rays"] and section["time"][0] == 0.0
    step = 50
    own = np.flatnonzero((m.snapshot == step) & (truth.measurement_vt >= 0) & ~np.isnan(m.azimuth_rad))
    ends = np.reshape(scene["measured"][step], (-1, 3))
    there = truth.vts.position_m[truth.measurement_vt[own]]
    away = np.linalg.norm(there[:, None] - ends[None], axis=2).min(axis=1)
    # With errors of a few degrees over hundreds of metres.
    assert len(own) > 2 and np.all(away < 0.15 * np.linalg.norm(there - truth.poses[step, :3], axis=1) + 5.0)


def test_playback_of_half_an_hour_steps_a_second_and_shows_the_vts(toy_recording: Callable[..., Recording]) -> None:
    recording = toy_recording(snapshots=1500, truth=False)
    recording = dataclasses.replace(recording, time_s=10.0 * recording.time_s)
    none = np.zeros(1, np.int64)
    vts = VtEstimate(none, none, np.ones((1, 3)), np.eye(3)[None])
    result = TrialResult("toy", np.zeros((1500, 6)), np.tile(np.eye(6), (1500, 1, 1)), vts=vts)
    said = content(recording, result)
    (section,) = said["trials"]
    assert max(np.diff(section["time"])) <= 2.1 and np.median(np.diff(section["time"])) <= 1.1
    assert section["estimates"][0]["vts"] == [[1.0], [1.0], [1.0]]
    assert said["cities"] == {} and section["scene"]["city"] is None and "truth" not in section["scene"]


def shown(path: Path) -> Any:
    found = re.search(r'id="data">(.*?)</script>', path.read_text("utf-8"), re.S)
    assert found is not None
    return json.loads(found.group(1))


def test_rays_of_a_city_are_told_apart_by_kind_and_thinned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = prepare(load("tiny").world, 0, 0)
    receivers = world.drive.poses[::20, :3].copy()
    paths = trace(world.scene, world.sites_m, receivers, 1, diffraction=True)
    rays = Traced(paths, world.sites_m, receivers)
    write_city(tmp_path / "a.html", world.scene.city, rays)
    page = shown(tmp_path / "a.html")
    kinds = [ray[0] for own in page["trials"][0]["scene"]["rays"] for ray in own]
    bent = int((paths.edge >= 0).sum())
    assert len(kinds) == len(paths) < MOST_RAYS and kinds.count(DIFFRACTED) == bent > 0
    assert f"{bent} diffracted" in page["lead"] and page["trials"][0]["time"] == list(range(len(receivers)))
    monkeypatch.setattr("cellslam.benchmarks.report.city_page.MOST_RAYS", len(paths) // 2 - 1)
    write_city(tmp_path / "b.html", world.scene.city, rays)
    fewer = shown(tmp_path / "b.html")["trials"][0]
    assert fewer["time"] == list(range(0, len(receivers), 3)) and len(fewer["scene"]["rays"]) == len(fewer["time"])


@pytest.mark.slow
def test_a_run_can_be_reported_and_keeps_what_was_there(tmp_path: Path) -> None:
    out = tmp_path / "o"
    words = ["run", "tiny", "--no-figures", "--trials", "2", "--out", str(out), "--quiet"]
    words += [word for key, value in SHORT.items() for word in ("--set", f"{key}={value}")]
    assert main([*words, "--estimator", "dead-reckoning", "--estimator", "ekf-slam"]) == 0

    def scores(rows: list[Any]) -> dict[Any, Any]:
        return {(row["estimator"], row["trial"]): row["position_rmse_m"] for row in rows}

    expected = scores(json.loads((out / "summary.json").read_text())["rows"])
    assert scores(results(out).to_dict("records")) == expected
    assert main(["report", str(out), "--quiet"]) == 0
    trial = shown((out / "report.html").rename(tmp_path / "page.html"))["trials"][0]
    assert trial["label"] == "ekf-slam" and trial["scene"]["city"] and len(trial["estimates"]) == 2
    assert main([*words, "--estimator", "dead-reckoning", "--set", "radio.load=0.9"]) == 0
    assert len(results(out)) == 6
