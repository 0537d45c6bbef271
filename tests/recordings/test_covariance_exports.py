"""Exports with covariances: what other tools make of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from cellslam.benchmarks.scores.metrics import Scored
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.trials.output_files import write_tum
from cellslam.recordings.exporting.covariances import in_body, in_world, write_side_file, write_square
from cellslam.recordings.exporting.mcap_file import definition, write_mcap
from cellslam.sim.recording import Recording
from cellslam.slam.api import VtEstimate, WallEstimate
from tests.command_line import Run, refused

Toy = Callable[..., Recording]


def claiming(recording: Recording, turned: bool = False) -> TrialResult:
    """An estimate that errs as it says, horizontally alone; where `turned`, in its angles too."""
    rng, count = np.random.default_rng(7), len(recording.time_s)
    assert recording.truth is not None
    one = np.diag([0.0, 0.0, 4.0, 0.01, 0.002, 0.003])
    one[:2, :2] = [[4.0, 1.5], [1.5, 1.0]]
    error = rng.multivariate_normal(np.zeros(6), one, count)
    error[:, 2] = 0.0
    error[:, 3:] *= turned
    vts = VtEstimate(
        np.arange(2), np.zeros(2, int), rng.normal(0, 50, (2, 3)), np.tile(np.diag([1.0, 4.0, 9.0]), (2, 1, 1))
    )
    walls = WallEstimate(np.zeros(1, int), np.zeros(1), np.full(1, 30.0), np.eye(2)[None], np.array([[-5.0, 5.0]]))
    poses = recording.truth.poses + error
    return TrialResult("mine", poses, np.tile(one, (count, 1, 1)), vts=vts, walls=walls)


def test_covariances_are_those_of_rotation_vectors() -> None:
    rng = np.random.default_rng(1)
    pose = np.array([[1.0, 2.0, 3.0, 2.5, 0.4, -0.7]])
    P = np.diag([1.0, 2.0, 3.0, 0.01, 0.02, 0.005]) * 1e-4
    drawn = pose + rng.multivariate_normal(np.zeros(6), P, 200_000)
    mean, turned = (Rotation.from_euler("ZYX", angles[:, 3:]) for angles in (pose, drawn))
    moved = drawn[:, :3] - pose[:, :3]
    right = np.column_stack([mean[0].inv().apply(moved), (mean[0].inv() * turned).as_rotvec()])
    left = np.column_stack([moved, (turned * mean[0].inv()).as_rotvec()])
    for found, sample in ((in_body(pose, P[None]), right), (in_world(pose, P[None]), left)):
        std = np.sqrt(np.diag(found[0]))
        np.testing.assert_allclose(found[0] / np.outer(std, std), np.cov(sample.T) / np.outer(std, std), atol=0.02)


def test_smfeval_agrees(toy_recording: Toy, tmp_path: Path) -> None:
    pytest.importorskip("smfeval", reason="smfeval is not installed: pip install smfeval")
    from smfeval.io import load_estimate
    from smfeval.scoring.logscore import gaussian_log_score_components

    recording = toy_recording(snapshots=60)
    result, truth = claiming(recording), recording.truth
    assert truth is not None
    write_square(tmp_path / "a.SQUARE", "mine", recording.time_s, result.poses, result.covariances)
    write_tum(tmp_path / "a.tum", recording.time_s, result.poses)
    write_side_file(tmp_path / "a.tum.cov", recording.time_s, result.poses, result.covariances)
    expected = Scored(recording, result, None).errors.squared
    turns = Rotation.from_euler("ZYX", truth.poses[:, 3:]).as_quat()
    for file, more, digits in (
        ("a.SQUARE", {}, 1e-6),
        ("a.tum", {"cov": tmp_path / "a.tum.cov", "body_frame": "v"}, 1e-4),
    ):
        header, steps = load_estimate(tmp_path / file, **more)
        known = zip(steps, truth.poses, turns, strict=True)
        found = np.array(
            [gaussian_log_score_components(s, p[:3], q, header.tangent_order).translation.nees for s, p, q in known]
        )
        np.testing.assert_allclose(found, expected, rtol=digits, atol=digits)
        for level in (0.5, 0.9):
            threshold = chi2.ppf(level, 3)
            assert np.mean(found <= threshold) == np.mean(expected <= threshold)


def read_back(file: Path) -> Iterator[tuple[str, str, int, Any]]:
    """Topic, type, time in ns and content of each message, by the schemas in the file."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with file.open("rb") as opened:
        for schema, channel, message, content in make_reader(
            opened, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            yield channel.topic, schema.name, message.log_time, content


def test_mcap_is_read_back_with_its_own_package(toy_recording: Toy, tmp_path: Path) -> None:
    pytest.importorskip("mcap_ros2", reason="mcap is not installed: pip install 'cellslam[mcap]'")
    recording = toy_recording(snapshots=20)
    result = claiming(recording, turned=True)
    write_mcap(recording, result, None, tmp_path / "a.mcap")
    found: dict[str, list[Any]] = {}
    for topic, *message in read_back(tmp_path / "a.mcap"):
        found.setdefault(topic, []).append(message)
    assert {topic: len(own) for topic, own in found.items()} == {
        "/estimate": 20, "/tf": 20, "/measurements": 20, "/truth": 20, "/map": 1,
    }  # fmt: skip
    kind, time_ns, last = found["/estimate"][-1]
    assert kind == "geometry_msgs/msg/PoseWithCovarianceStamped"
    assert time_ns == pytest.approx(1e9 * recording.time_s[-1])
    pose, at = last.pose, last.header.stamp
    assert at.sec + 1e-9 * at.nanosec == pytest.approx(recording.time_s[-1])
    assert [pose.pose.position.x, pose.pose.position.z] == pytest.approx(result.poses[-1, [0, 2]])
    covariance = np.array(pose.covariance).reshape(6, 6)
    np.testing.assert_allclose(covariance, in_world(result.poses, result.covariances)[-1])
    cloud, m = found["/measurements"][-1][-1], recording.measurements
    points = np.frombuffer(bytes(cloud.data), "<f4").reshape(-1, 5)
    mine = m.snapshot == 19
    assert cloud.width == len(points) == mine.sum() and cloud.header.frame_id == "vehicle"
    np.testing.assert_allclose(np.linalg.norm(points[:, :3], axis=1), m.distance_m[mine], rtol=1e-6)
    markers = found["/map"][0][-1].markers
    assert [marker.ns for marker in markers] == ["vts", "vts", "walls"]
    assert sorted([markers[0].scale.x, markers[0].scale.y, markers[0].scale.z]) == pytest.approx([4.0, 8.0, 12.0])
    assert len(markers[2].points) == 2 and markers[2].points[0].x == pytest.approx(30.0)
    assert definition("tf2_msgs/TFMessage").count("=" * 80) == 5


@pytest.mark.slow
def test_the_city_of_a_simulated_drive_is_in_the_file(cellslam: Run, tmp_path: Path) -> None:
    pytest.importorskip("mcap_ros2", reason="mcap is not installed: pip install 'cellslam[mcap]'")
    assert cellslam("record", "tiny", "--out", "a.h5").status == 0
    assert cellslam("export", "a.h5", "--format", "mcap", "--out", "a.mcap").status == 0
    kinds = {topic: message for topic, _, _, message in read_back(tmp_path / "a.mcap")}
    assert set(kinds) == {"/truth", "/city"} and len(kinds["/city"].markers[0].points) % 3 == 0


def test_export_writes_covariances(toy_recording: Toy, tmp_path: Path, cellslam: Run) -> None:
    toy_recording(snapshots=20).save(tmp_path / "a.h5")
    both = ("--format", "tum", "--out", "t.tum", "--format", "square", "--out", "t.SQUARE")
    assert cellslam("export", "a.h5", "--estimator", "dead-reckoning", *both).status == 0
    assert np.loadtxt("t.tum.cov").shape == (20, 22) and np.loadtxt("t.SQUARE").shape == (20, 29)
    refused(cellslam("export", "a.h5", "--format", "square", "--out", "x"), "--estimator")
    assert cellslam("export", "a.h5", "--format", "tum", "--out", "u.tum").status == 0
    assert not (tmp_path / "u.tum.cov").exists()


def test_a_smoothers_covariances_are_not_of_its_poses(toy_recording: Toy) -> None:
    recording = toy_recording(snapshots=10)
    assert not np.isfinite(
        Scored(recording, dataclasses.replace(claiming(recording), smoothed=True), None).errors.squared
    ).any()
