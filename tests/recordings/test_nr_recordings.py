"""A recorded drive of NR says what was sent and what its receiver's data sheet is; replay estimates with both."""

from __future__ import annotations

import pytest

from cellslam.scenarios.recording_origin import Origin
from cellslam.sim.recording import Recording
from tests.command_line import Run

KEYS = {"technology": "nr", "carrier_hz": 3.5e9, "numerology": 1, "prs_comb": 12, "prs_symbols": 12}


@pytest.mark.slow
@pytest.mark.parametrize(("front_end", "blocks", "noise_m"), [("statistical", 272, 0.00185), ("signal", 48, 0.0249)])
def test_a_recording_keeps_the_resource(front_end: str, blocks: int, noise_m: float, cellslam: Run) -> None:
    keys = KEYS | {"resource_blocks": blocks}
    drive = {"distance_m": 2, "duration_s": 6, "snapshot_interval_s": 0.6, "stops": 0}
    sets = [f"radio.{key}={value}" for key, value in {**keys, "front_end": front_end}.items()]
    sets += [f"vehicle.{key}={value}" for key, value in drive.items()]
    words = [word for one in sets for word in ("--set", one)]
    assert cellslam("record", "tiny", "--out", "drive.h5", "--quiet", *words).status == 0
    origin = Origin.of(Recording.load("drive.h5"))
    assert origin.scenario is not None
    assert {key: getattr(origin.scenario.radio, key) for key in keys} == keys
    assert origin.options["ekf-slam"]["noise_unit_snr_m"] == pytest.approx(noise_m, rel=0.01)
    (row,) = cellslam("replay", "drive.h5", "--estimator", "ekf-slam", "--no-figures", "--quiet", "--json").rows
    assert row["status"] == "ok"
