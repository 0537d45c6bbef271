"""`cellslam bench snapshot`: the picture of one snapshot at signal level."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellslam.cli.main import main


@pytest.mark.slow
def test_picture_of_a_snapshot(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "one.png"
    assert main(["bench", "snapshot", "tiny", "--at", "3", "--out", str(out), "--quiet"]) == 0
    assert "true paths" in capfd.readouterr().out
    assert out.stat().st_size > 10_000
    assert main(["bench", "snapshot", "tiny", "--at", "100000", "--out", str(out)]) == 2
    assert "the drive has snapshots 0 to" in capfd.readouterr().err
