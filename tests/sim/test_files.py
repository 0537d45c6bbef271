"""Files on full disks and after crashes, and folders that others could write into."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cellslam.sim import files
from cellslam.sim.errors import InputError
from cellslam.sim.files import private_folder, write_durably
from cellslam.sim.recording import Recording


def test_content_and_name_are_on_the_disk_before_it_returns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[str] = []
    for name in ("fsync", "replace"):
        real = getattr(os, name)
        monkeypatch.setattr(os, name, lambda *given, name=name, real=real: (steps.append(name), real(*given))[1])
    path = tmp_path / "a"
    write_durably(path, b"content")
    assert steps == ["fsync", "replace", "fsync"] and path.read_bytes() == b"content"


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 64 kB; only root can make one."""
    place = tmp_path / "disk"
    place.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(place)]
    if os.getuid() != 0 or subprocess.run(words, capture_output=True, check=False).returncode != 0:
        pytest.skip("a small file system cannot be mounted here")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def test_a_recording_on_a_full_disk_is_one_line_without_litter(
    toy_recording: Callable[..., Recording], small_disk: Path
) -> None:
    """In a process of its own, which the HDF5 library would end."""
    source = small_disk.parent / "toy.h5"
    toy_recording(snapshots=3000).save(source)
    code = "import sys; from cellslam.sim.recording import Recording; Recording.load(sys.argv[1]).save(sys.argv[2])"
    words = [sys.executable, "-c", code, str(source), str(small_disk / "a.h5")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode != -signal.SIGSEGV and "InputError" in done.stderr and "No space left" in done.stderr
    assert list(small_disk.iterdir()) == []
    with pytest.raises(OSError, match="No space left"):
        write_durably(small_disk / "report.html", bytes(100_000))
    assert list(small_disk.iterdir()) == []
    with pytest.raises(InputError, match="No space left"):
        Recording.load(source).save(small_disk / "b.h5")


@pytest.fixture
def shared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(files.tempfile, "gettempdir", lambda: str(tmp_path))
    tmp_path.chmod(0o1777)
    return tmp_path


def test_a_private_folder_is_made_and_found_again(shared: Path) -> None:
    found = private_folder("kernels")
    assert found is not None and found.stat().st_mode & 0o777 == 0o700
    assert found.parent.parent == shared and private_folder("kernels") == found


def opened_to_all(shared: Path) -> None:
    (shared / f"cellslam-{os.getuid()}").mkdir()
    (shared / f"cellslam-{os.getuid()}").chmod(0o777)


def a_link(shared: Path) -> None:
    (shared / "elsewhere").mkdir(mode=0o700)
    (shared / f"cellslam-{os.getuid()}").symlink_to(shared / "elsewhere")


def a_file(shared: Path) -> None:
    (shared / f"cellslam-{os.getuid()}").touch()


def of_another_user(shared: Path) -> None:
    if os.getuid() != 0:
        pytest.skip("only root can give a folder to another user")
    (shared / f"cellslam-{os.getuid()}").mkdir(mode=0o700)
    os.chown(shared / f"cellslam-{os.getuid()}", 12345, 12345)


def without_sticky_bit(shared: Path) -> None:
    shared.chmod(0o777)


@pytest.mark.parametrize("prepare", [opened_to_all, a_link, a_file, of_another_user, without_sticky_bit])
def test_no_folder_that_others_could_write_into(shared: Path, prepare: Callable[[Path], None]) -> None:
    prepare(shared)
    assert private_folder("kernels") is None
