"""The layout of the 60 GHz campaign of Tampere, written from a simulated hall."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial import cKDTree

from cellslam.recordings.adapters.adapter_loading import import_adapter
from cellslam.recordings.adapters.tampere_60ghz import NAME
from cellslam.sim.errors import InputError

SOURCES = np.array([[9.0, 1.0], [-25.0, 1.0], [9.0, 13.0], [9.0, -15.0]])  # a transmitter and its mirror images


def test_the_60_ghz_campaign(tmp_path: Path, position_rmse: Callable[..., float]) -> None:
    """45 places in a hall, a transmitter, three walls."""
    rng = np.random.default_rng(7)
    angle = np.linspace(0, 1.5 * np.pi, 45)
    rx = np.stack([6 * np.cos(angle), 4 * np.sin(angle), angle + np.pi / 2])
    y, power = np.empty((1, 45), object), np.empty((1, 45), object)
    for k in range(45):
        d = SOURCES - rx[:2, k]
        arrival = np.arctan2(d[:, 1], d[:, 0]) - rx[2, k] + np.radians(1.0) * rng.standard_normal(4)
        y[0, k] = np.stack([np.hypot(*d.T) + 0.1 * rng.standard_normal(4), rng.uniform(-3, 3, 4), arrival + 4 * np.pi])
        power[0, k] = rng.uniform(-90, -50, (1, 4))
    savemat(tmp_path / NAME, {"sim": {"rx": rx, "tx": np.tile([[9.0], [1.0], [0.0]], 45), "y": y, "power": power}})
    r = import_adapter(tmp_path, "tampere-60ghz")
    assert len(r.time_s) == 45 and len(r.measurements) == 180 and r.plane
    assert r.reference is not None and np.isfinite(r.reference.yaw_rad).all()
    pose, m = np.column_stack([r.reference.position_m[:, :2], r.reference.yaw_rad]), r.measurements
    towards = pose[m.snapshot, 2] + m.azimuth_rad
    ends = pose[m.snapshot, :2] + m.distance_m[:, None] * np.column_stack([np.cos(towards), np.sin(towards)])
    assert np.quantile(cKDTree(SOURCES).query(ends)[0], 0.95) < 1.2
    assert "simulated" in r.provenance["description"] and r.sites.position_m is None
    known = import_adapter(tmp_path, "tampere-60ghz", {"sites": "known"})
    np.testing.assert_array_equal(known.sites.surveyed_m, [[*SOURCES[0], 0.0]])
    np.testing.assert_array_equal(known.links.azimuth_rad, [0.0])
    assert position_rmse(r, "fastslam", particles=100, noise_model="claimed") < position_rmse(r, "dead-reckoning")


def test_a_60_ghz_file_that_lacks_something(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no Kampusareena"):
        import_adapter(tmp_path, "tampere-60ghz")
    savemat(tmp_path / NAME, {"sim": {"rx": np.zeros((3, 2))}})
    with pytest.raises(InputError, match="'sim' has no field 'tx'"):
        import_adapter(tmp_path, "tampere-60ghz")
    cells = np.empty((1, 2), object)
    cells[0, :] = [np.zeros((3, 4)), np.zeros((2, 4))]
    for rx, text in (
        (np.zeros((3, 5)), "(3, 5), expected (3, 2) as sim.y"),
        (np.zeros((3, 2)), "cell 1 has shape"),
    ):
        savemat(tmp_path / NAME, {"sim": {"rx": rx, "tx": np.zeros(3), "y": cells}})
        with pytest.raises(InputError, match=re.escape(text)):
            import_adapter(tmp_path, "tampere-60ghz")
