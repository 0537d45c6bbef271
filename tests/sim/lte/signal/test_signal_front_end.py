"""The signal-level front end: diffuse energy, a link from air to measurement, blocks, restart, what it refuses."""

from __future__ import annotations

import io
import os
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from cellslam.sim.errors import InputError
from cellslam.sim.lte import RadioConfig
from cellslam.sim.lte.links import Cells, cells_of
from cellslam.sim.lte.persisting_errors import draw_fields
from cellslam.sim.lte.signal import drive_in_blocks as streaming
from cellslam.sim.lte.signal.block_processes import in_processes
from cellslam.sim.lte.signal.signal_front_end import SignalLevel, signal_level
from cellslam.sim.lte.statistical.detector_layout import PathColumns

Floats = NDArray[np.float64]
SITES = np.array([[-150.0, 60.0, 35.0], [120.0, -160.0, 40.0]])
WALL = np.array([-60.0, 260.0, 30.0])


def make_cells(ports: int = 2) -> Cells:
    """Two sites, one cell each, whose reference elements collide."""
    cells = [SimpleNamespace(cell_id=c, azimuth_deg=a, tilt_deg=6.0) for c, a in ((375, -20.0), (177, 120.0))]
    return cells_of([SimpleNamespace(cells=[cell], ports=ports) for cell in cells])


def front_end(**radio: float | str) -> SignalLevel:
    config = RadioConfig(**radio)
    fields = draw_fields(config, 0.075, np.random.default_rng(1))
    return signal_level(config, make_cells(), np.array([80.0, -130.0]), fields, np.random.default_rng(2))


def drive(count: int) -> tuple[PathColumns, Floats, Floats]:
    """Line of sight to both sites and a reflection of the first, from places along a street."""
    poses = np.zeros((count, 6))
    poses[:, 0], poses[:, 2] = 0.3 * np.arange(count), 1.8
    velocity = np.tile([1.5, 0.0, 0.0, 0.0, 0.0, 0.0], (count, 1))
    vts = np.array([SITES[0], WALL, SITES[1]])
    length = np.linalg.norm(vts[None] - poses[:, None, :3], axis=-1)
    amplitude = 0.113 / (4.0 * np.pi * length) * np.array([1.0, 0.4, 1.0])
    gain = amplitude.reshape(-1, 1, 1) * np.eye(2)
    towards = poses[:, None, :3] - vts[None]
    departure = np.stack(
        [np.arctan2(towards[..., 1], towards[..., 0]), np.arcsin(towards[..., 2] / length)], -1
    ).reshape(-1, 2)
    rows = np.concatenate([[0], np.cumsum(np.tile([2, 1], count))])
    return PathColumns(rows, np.tile(vts, (count, 1)), gain.astype(np.complex128), departure), poses, velocity


NR = {"technology": "nr", "front_end": "signal", "carrier_hz": 3.5e9, "prs_comb": 4, "prs_symbols": 4}
OWN = {"technology": "pilot_tones:PilotTones", "front_end": "signal"}


@pytest.mark.parametrize(
    ("radio", "count"), [({}, 6), (NR | {"resource_blocks": 52}, 4), (OWN, 4)], ids=["lte", "nr", "own"]
)
def test_paths_are_measured_as_claimed(
    radio: dict[str, float | str], count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Root mean square errors of what is found of true paths are at most twice those that the front end claims."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[4] / "docs" / "examples" / "own-waveform"))
    paths, poses, velocity = drive(count)
    signals = front_end(specular_to_diffuse_db=15.0, **radio)
    d = streaming.detect_signals(signals, paths, poses, velocity, velocity, np.random.default_rng(3))
    m, real = d.measurements, d.path >= 0
    assert real.sum() >= 0.9 * count * 2 * 3
    assert radio or (~real).sum() < count * 4 * 2  # clutter, of LTE
    assert (np.diff(m.snapshot * 4 + m.link) >= 0).all()
    towards = paths.vt_m[d.path[real]] - poses[m.snapshot[real], :3]
    distance = np.linalg.norm(towards, axis=1) + np.array([80.0, -130.0])[m.link[real] // 2]
    azimuth = np.arctan2(towards[:, 1], towards[:, 0])
    assert m.distance_std_m is not None and m.azimuth_std_rad is not None
    for error, claimed in (
        (m.distance_m[real] - distance, m.distance_std_m[real]),
        (m.azimuth_rad[real] - azimuth, m.azimuth_std_rad[real]),
    ):
        assert np.sqrt(np.mean((error / claimed) ** 2)) < 2.0


@pytest.mark.slow
def test_processes_snapshots_and_a_restart_give_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    paths, poses, velocity = drive(4)
    rng, signals = np.random.default_rng(4), front_end()
    monkeypatch.setattr(streaming, "BLOCK", 1)  # so many blocks that several processes measure them
    whole = streaming.detect_signals(signals, paths, poses, velocity, velocity, rng)
    monkeypatch.setattr(streaming, "BLOCK", 2)
    one, low = paths.of_snapshots(1, 2, 2)
    alone = streaming.detect_signals(signals, one, poses[1:2], velocity[1:2], velocity[1:2], rng, first_snapshot=1)
    rows = whole.measurements.snapshot == 1
    np.testing.assert_array_equal(alone.measurements.distance_m, whole.measurements.distance_m[rows])
    np.testing.assert_array_equal(np.where(alone.path >= 0, alone.path + low, -1), whole.path[rows])

    measured: list[int] = []

    def counted(self: SignalLevel, *arguments: object) -> Floats:
        measured.append(arguments[4])  # type: ignore[arg-type]
        if fails and arguments[4] == 3:
            raise KeyboardInterrupt
        return original(self, *arguments)  # type: ignore[arg-type]

    original, fails = SignalLevel.measure, True
    monkeypatch.setattr(SignalLevel, "measure", counted)
    with pytest.raises(KeyboardInterrupt):
        streaming.detect_signals(signals, paths, poses, velocity, velocity, rng, trial_key="a")
    assert sorted(measured) == [0, 1, 2, 3]
    kept = sorted(tmp_path.rglob("*.block"))
    assert len(kept) == 1
    fails, before = False, len(measured)
    resumed = streaming.detect_signals(signals, paths, poses, velocity, velocity, rng, trial_key="a")
    assert measured[before:] == [2, 3]
    np.testing.assert_array_equal(resumed.measurements.distance_m, whole.measurements.distance_m)
    assert not any(path.is_file() for path in tmp_path.rglob("*"))


def test_a_block_that_was_changed_is_no_block(tmp_path: Path) -> None:
    file, table = tmp_path / "trial" / "0.block", np.arange(12.0).reshape(4, 3)
    assert streaming._kept(file) is None
    streaming._keep(file, table)
    np.testing.assert_array_equal(streaming._kept(file), table)
    half = io.BytesIO()
    np.save(half, table[:2])
    whole = file.read_bytes()
    for content in (half.getvalue(), whole[:-24], whole[:40], whole[:-1] + b"x"):
        file.write_bytes(content)
        assert streaming._kept(file) is None


def test_answers_of_processes_come_in_order_and_errors_come_through() -> None:
    assert [a.tolist() for a in in_processes(partial(np.full, 2), range(5), 2)] == [[i, i] for i in range(5)]
    with pytest.raises(ZeroDivisionError):
        list(in_processes(partial(divmod, 1), [1, 0], 1))
    with pytest.raises(InputError, match="status 3; finished blocks are kept"):
        list(in_processes(os._exit, [3], 1))


def test_what_it_cannot_do_is_refused() -> None:
    config, rng = RadioConfig(), np.random.default_rng(1)
    fields = draw_fields(config, 0.075, rng)
    with pytest.raises(InputError, match="ports 0 and 1"):
        signal_level(config, make_cells(4), np.zeros(2), fields, rng)
    for key in ({"noise_scale": 0.0}, {"perfect_detection": True}, {"detection_scale": 0.5}):
        with pytest.raises(InputError, match="belong to the statistical front end"):
            front_end(**key)


def test_receivers_of_one_seed_share_their_array_and_nothing_else() -> None:
    def receiver(seed: int | None, trial: int) -> SignalLevel:
        config, rng = RadioConfig(front_end="signal", array_seed=seed), np.random.default_rng(trial)
        return signal_level(config, make_cells(), np.zeros(2), draw_fields(config, 0.075, rng), rng)

    one, other, another, own = receiver(3, 1), receiver(3, 2), receiver(4, 1), receiver(None, 1)
    np.testing.assert_array_equal(one.array.calibration, other.array.calibration)
    for unlike in (another, own):
        assert not np.array_equal(one.array.calibration, unlike.array.calibration)
    assert one.surroundings != other.surroundings


def test_nr_samples_are_the_channel_and_other_cells_do_not_reach_them() -> None:
    quiet = {"noise_dbm": -140.0, "load": 0.0, "evm": 0.0, "specular_to_diffuse_db": 40.0}
    signals = front_end(resource_blocks=24, **NR, **quiet)
    paths, poses, velocity = drive(1)
    louder = paths._replace(gain=np.concatenate([paths.gain[:2], 100.0 * paths.gain[2:]]))
    slots = signals.slots(0)
    seen = [
        signals.samples(0, signals.receive(p, poses[0], velocity[0, :3], 0, slots, np.random.default_rng(1)), slots)
        for p in (paths, louder)
    ]
    assert np.abs(seen[0]).mean() > 1e3 * np.sqrt(signals.config.noise_mw())
    np.testing.assert_allclose(seen[1], seen[0], rtol=1e-6)
    # Over subcarriers a channel of three short paths changes slowly, whatever symbols they come from.
    steps = np.abs(np.diff(seen[0], axis=1)).max() / np.abs(seen[0]).max()
    assert steps < 2.0 * np.pi * 500.0 * 30e3 / 3e8
