"""A recorded drive of NR says what was sent and what its receiver's data sheet is; replay estimates with both."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cellslam.cli.main import main
from cellslam.scenarios.recording_origin import Origin
from cellslam.sim.recording import Recording

KEYS = {"technology": "nr", "carrier_hz": 3.5e9, "numerology": 1, "prs_comb": 12, "prs_symbols": 12}


@pytest.mark.slow
@pytest.mark.parametrize(("front_end", "blocks", "noise_m"), [("statistical", 272, 0.00185), ("signal", 48, 0.0249)])
def test_a_recording_keeps_the_resource(
    front_end: str, blocks: int, noise_m: float, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file, keys = tmp_path / "drive.h5", KEYS | {"resource_blocks": blocks}
    sets = [f"radio.{key}={value}" for key, value in keys.items()]
    sets += [
        f"radio.front_end={front_end}",
        "vehicle.distance_m=2",
        "vehicle.duration_s=6",
        "vehicle.snapshot_interval_s=0.6",
        "vehicle.stops=0",
    ]
    assert main(["record", "tiny", "--out", str(file), "--quiet", *(word for s in sets for word in ("--set", s))]) == 0
    origin = Origin.of(Recording.load(file))
    assert origin.scenario is not None
    assert {key: getattr(origin.scenario.radio, key) for key in keys} == keys
    assert origin.options["ekf-slam"]["noise_unit_snr_m"] == pytest.approx(noise_m, rel=0.01)
    capfd.readouterr()
    assert main(["replay", str(file), "--estimator", "ekf-slam", "--no-figures", "--quiet", "--json"]) == 0
    (row,) = json.loads(capfd.readouterr().out)
    assert row["status"] == "ok"
