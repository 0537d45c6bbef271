"""Sets of drives: shards and one run give the same bytes; damage is noticed; windows hold what the drives do."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cellslam
from cellslam.cli.main import main
from cellslam.recordings.sets.making import check, finish, make
from cellslam.scenarios.sets import CARD, INDEX, SETS, TRUTH
from cellslam.scenarios.sets.reading import COLUMNS, drives_of, index_of
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording

SMALL = replace(
    SETS["learn-lund"], name="small", preset="tiny", overrides={}, drives={"train": 3, "validation": 1, "test": 2}
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    assert sum(make(SMALL, folder)) == 8
    assert finish(SMALL, folder)
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_shards_in_any_order_give_the_bytes_of_one_run(whole: Path, tmp_path: Path) -> None:
    for number, last in ((2, False), (1, True)):
        list(make(SMALL, tmp_path, number, 2))
        assert finish(SMALL, tmp_path) == last
    assert files(tmp_path) == files(whole)
    assert sum(make(SMALL, tmp_path)) == 0, "a drive that is there is made again"


def test_a_set_is_as_it_was_made_or_is_refused(whole: Path, tmp_path: Path) -> None:
    assert len(list(check(whole))) == 8
    for name, content in files(whole).items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    drive = tmp_path / "train" / "0001.h5"
    drive.write_bytes((tmp_path / "train" / "0002.h5").read_bytes())  # whole in itself, but another one
    with pytest.raises(InputError, match=r"0001\.h5: is not the drive of index\.csv"):
        list(check(tmp_path))
    index = (tmp_path / INDEX).read_text()
    (tmp_path / INDEX).write_text(index.replace("train,2", "train,3"))
    with pytest.raises(InputError, match="is not the index of the card"):
        list(check(tmp_path))
    drive.write_bytes(drive.read_bytes()[:-1])
    with pytest.raises(InputError, match="damaged"):
        drives_of(tmp_path)[1].rows  # noqa: B018


@pytest.mark.parametrize("elsewhere", ["../x.h5", "/x.h5", "train/../../x.h5"])
def test_an_index_names_files_of_its_folder_alone(tmp_path: Path, elsewhere: str) -> None:
    (tmp_path / INDEX).write_text(f"{','.join(COLUMNS)}\n{elsewhere},train,0,1,1,1,0,\n")
    for read in (lambda: list(check(tmp_path)), lambda: drives_of(tmp_path)):
        with pytest.raises(InputError, match=rf"index\.csv: damaged \(it names the file {elsewhere}, outside"):
            read()


def test_a_drive_of_another_set_is_refused(whole: Path) -> None:
    other = replace(SMALL, overrides={"radio.load": 0.9})
    with pytest.raises(InputError, match="another set"):
        list(make(other, whole))


def test_the_test_split_has_no_truth_and_nothing_that_gives_it(whole: Path) -> None:
    hidden, known = (Recording.load(whole / split / "0000.h5") for split in ("test", TRUTH))
    assert hidden.truth is None and known.truth is not None
    np.testing.assert_array_equal(hidden.measurements.distance_m, known.measurements.distance_m)
    assert not {"seed", "trial", "bound_rmse_m"} & set(hidden.provenance)
    bounds = {row.split: row.bound_rmse_m for row in index_of(whole)}
    assert bounds["train"] == bounds["test"] == ""
    assert 0.0 < float(bounds["validation"]) < 10.0 and 0.0 < float(bounds[TRUTH]) < 10.0


@pytest.mark.parametrize("seed", [None, 3])
def test_windows_hold_what_the_drives_do(whole: Path, seed: int | None) -> None:
    shuffle = None if seed is None else np.random.default_rng(seed)
    seen: Counter[int] = Counter()
    drives = [Recording.load(whole / "train" / f"{trial:04}.h5") for trial in range(3)]
    for batch in cellslam.windows(whole, 70, 4, shuffle):
        for k, (number, first) in enumerate(zip(batch["drive"], batch["first"], strict=True)):
            drive = drives[number]
            assert drive.truth is not None
            seen[number] += 1
            rows = slice(drive.rows[first], drive.rows[first + 70])
            there = batch["mask"][k]
            np.testing.assert_array_equal(there.sum(axis=1), np.diff(drive.rows[first : first + 71]))
            assert not batch["paths"][k][~there].any() and (batch["vt"][k][~there] == -1).all()
            paths = batch["paths"][k][there]
            np.testing.assert_allclose(paths[:, 0], drive.measurements.distance_m[rows], rtol=1e-6)
            np.testing.assert_allclose(paths[:, 6], drive.measurements.elevation_std_rad[rows], rtol=1e-6)
            np.testing.assert_array_equal(batch["link"][k][there], drive.measurements.link[rows])
            np.testing.assert_array_equal(batch["vt"][k][there], drive.truth.measurement_vt[rows])
            np.testing.assert_allclose(batch["pose"][k], drive.truth.poses[first : first + 70], atol=1e-3)
            np.testing.assert_allclose(batch["odometry"][k], drive.odometry[first : first + 70], atol=1e-4)
            clocks = drive.truth.clock_offsets_at(drive.elapsed_s)[first : first + 70]
            np.testing.assert_allclose(batch["clock_offset_m"][k], clocks, rtol=1e-6)
            assert all(array.flags.c_contiguous for array in batch.values())
    assert set(seen) == {0, 1, 2} and set(seen.values()) == {len(drives[0].time_s) // 70}


def test_windows_of_a_seed_repeat_and_others_differ(whole: Path) -> None:
    def order(seed: int) -> list[tuple[int, int]]:
        batches = cellslam.windows(whole, 50, 3, np.random.default_rng(seed))
        return [place for batch in batches for place in zip(batch["drive"], batch["first"], strict=True)]

    assert order(1) == order(1) != order(2)
    hidden = next(cellslam.windows(whole, 50, 3, split="test"))
    assert {"pose", "vt", "clock_offset_m"}.isdisjoint(hidden)
    with pytest.raises(InputError, match="no drive of 'train' has 5000 snapshots"):
        next(cellslam.windows(whole, 5000, 3))
    with pytest.raises(InputError, match="not a whole set"):
        next(cellslam.windows(whole / "train", 50, 3))


def test_what_named_sets_are_made_of_does_not_change() -> None:
    assert {name: one.digest[:12] for name, one in SETS.items()} == {
        "learn-lund": "d2b455709798", "learn-cities": "01afefabc2ce", "learn-signal": "066e6637e316",
    }  # fmt: skip


def test_the_card_says_what_is_there(whole: Path) -> None:
    card = json.loads((whole / CARD).read_text())
    assert card["version"].endswith(SMALL.digest[:12])
    sets = {part["includes"] for part in card["distribution"] if part["@type"] == "cr:FileSet"}
    assert sets == {f"{split}/*.h5" for split in ("train", "validation", "test", TRUTH)}


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the validator's own dependencies
def test_the_card_passes_the_validator_of_the_format(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    croissant = pytest.importorskip("mlcroissant", reason="mlcroissant is not installed")
    monkeypatch.chdir(whole)
    dataset = croissant.Dataset(CARD)
    assert not dataset.metadata.ctx.issues.errors and not dataset.metadata.ctx.issues.warnings
    assert len(list(dataset.records("drives"))) == 8


def test_commands(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(SETS, "small", SMALL)
    assert main(["dataset", "list"]) == 0
    assert "small" in capfd.readouterr().out
    assert main(["dataset", "make", "small", "--out", str(tmp_path), "--shard", "3/6"]) == 0
    assert "drives of other shards are missing" in capfd.readouterr().err
    assert main(["dataset", "make", "small", "--out", str(whole)]) == 0
    assert "0 files made" in capfd.readouterr().err
    assert main(["dataset", "check", str(whole)]) == 0
    assert "8 files with" in capfd.readouterr().err
    assert main(["dataset", "check", str(tmp_path)]) == 2


@pytest.mark.slow
def test_raw_responses_lie_beside_the_drives_and_are_checked_too(tmp_path: Path) -> None:
    few = {"vehicle.duration_s": 8.0, "vehicle.distance_m": 2.0, "vehicle.stops": 0}
    overrides = {**SETS["learn-signal"].overrides, **few, "traffic.vehicles_per_km": 0.0}
    drives = {"train": 1, "validation": 0, "test": 1}
    one = replace(SETS["learn-signal"], preset="tiny", overrides=overrides, drives=drives)
    assert list(make(one, tmp_path)) == [2, 3]
    assert finish(one, tmp_path)
    assert len(list(check(tmp_path))) == 5
    responses = tmp_path / "test" / "0000-responses.h5"
    content = bytearray(responses.read_bytes())
    content[-1000] ^= 1
    responses.write_bytes(content)
    with pytest.raises(InputError, match=r"0000-responses\.h5: is not the drive of index\.csv"):
        list(check(tmp_path))
