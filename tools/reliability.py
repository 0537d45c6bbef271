"""Kill sweeps, fill disks, damage files; go on with the same command, and count what is lost: the table of the page on
reliability.

Full disks are a tmpfs of 8 MB that a filler leaves a few kilobytes of, which needs the right to mount; without it
files may grow to a few kilobytes (RLIMIT_FSIZE).
"""

from __future__ import annotations

import io
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from argparse import ArgumentParser, Namespace
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any, NamedTuple

import psutil

from cellslam.benchmarks.sweeps.store import DATABASE, TRAJECTORIES
from cellslam.cli.arguments import DONE, FAILED, WRONG
from cellslam.cli.main import main
from tests.benchmarks.sweeps.short_sweeps import rows, start, stored, wait_for, words
from tests.damaged_files import sound_files
from tests.short_drive import SHORT

TRIALS = 12
ESTIMATORS = ("dead-reckoning",)
DISK_BYTES = 8 * 2**20
FREE_DECADES = (2.0, 5.3)  # a full disk has 100 bytes to 200 kB left: files written here have 4 kB to 5 MB
KILL_WAIT_ROWS, KILL_WAIT_S = 4, 1.0
HEADINGS = ("what was done", "times", "lost", "what the user saw")
Row = dict[str, Any]


class Outcome(NamedTuple):
    """A line of the table; `wrong`: what should not have happened."""

    what: str
    times: int
    lost: str
    seen: str
    wrong: tuple[str, ...] = ()


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this tool."""
    parser.add_argument("--kills", type=int, default=30, help="of drivers, and half as many of workers (default: 30)")
    parser.add_argument("--disks", type=int, default=10, help="full disks for each command (default: 10)")
    parser.add_argument("--damages", type=int, default=10, help="of each kind and file (default: 10)")
    parser.add_argument("--seed", type=int, default=0, help="of moments, sizes and damage (default: 0)")


def command(arguments: Namespace) -> int:
    """Print the table as it grows, and on stderr what should not have happened."""
    wrong = 0
    print(f"| {' | '.join(HEADINGS)} |\n{'|---' * len(HEADINGS)}|", flush=True)
    with tempfile.TemporaryDirectory() as name:
        for one in outcomes(Path(name), arguments, random.Random(arguments.seed)):
            print(f"| {one.what} | {one.times} | {one.lost} | {one.seen} |", flush=True)
            wrong += len(one.wrong)
            for text in one.wrong:
                print(f"{one.what}: {text}", file=sys.stderr, flush=True)
    return FAILED if wrong else DONE


def outcomes(folder: Path, arguments: Namespace, draw: random.Random) -> Iterator[Outcome]:
    """Yield the lines of the table."""
    whole = folder / "whole"
    outcome_of(*words(*ESTIMATORS, out=str(whole), trials=TRIALS, more=("--executor", "serial")))
    expected = rows(whole)
    for driver, times in ((True, arguments.kills), (False, arguments.kills // 2)):
        if times:
            yield kills(folder, expected, times, draw, driver)
    if arguments.disks:
        yield from full_disks(folder / "disk", whole, expected, arguments.disks, draw)
    if arguments.damages:
        yield from damaged_results(folder, whole, expected, arguments.damages, draw)
        yield from damaged_files(folder, arguments.damages, draw)


def outcome_of(*line: str) -> tuple[int, str, str]:
    """Return exit status, stdout and stderr of a command, carried out in this process."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = main(line)
    return status, out.getvalue(), err.getvalue()


def kills(folder: Path, expected: list[Row], times: int, draw: random.Random, driver: bool) -> Outcome:
    """Kill the driver, or a worker, of a sweep at random moments; each driver is followed by the same command."""
    line = words(*ESTIMATORS, out="", trials=TRIALS, more=("--jobs", "2"))
    seen = lost = number = done = 0
    wrong = list[str]()
    while done < times:
        out, number = folder / f"kills-{driver}-{number}", number + 1
        line[line.index("--out") + 1] = str(out)
        while done < times and (not out.exists() or len(rows(out)) < len(expected)):
            stored_before = stored(out)
            process = start(line)
            while done < times and process.poll() is None:
                wanted = stored(out) + draw.randrange(KILL_WAIT_ROWS)
                wait_for(lambda: stored(out) >= wanted, process)  # noqa: B023
                time.sleep(draw.uniform(0.0, KILL_WAIT_S))
                there = rows(out) if stored(out) else []
                with suppress(IndexError, psutil.NoSuchProcess):
                    hit = psutil.Process(process.pid)
                    (hit if driver else draw.choice(hit.children())).kill()
                    done, seen = done + 1, seen + len(there)
                if driver:
                    process.communicate()
                    kept = rows(out) if stored(out) else []
                    lost += sum(row not in kept for row in there) + max(stored_before - len(kept), 0)
            process.communicate()
        process = start([*line, "--retry-failed"])
        _, err = process.communicate()
        wrong += [f"status {process.returncode}: {err}"] if process.returncode else []
        lost += sum(row not in rows(out) for row in expected)
    what = "driver of a sweep killed (SIGKILL), same command again" if driver else "worker of a sweep killed (SIGKILL)"
    note = "goes on from there" if driver else "nothing: what it was at is done again"
    return Outcome(what, done, f"{lost} of {seen if driver else number * len(expected)} rows", note, (*wrong,))


@contextmanager
def small_disk(folder: Path) -> Iterator[bool]:
    """Make `folder` a small disk of its own, if this process may; yield whether it is."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(folder)]
    mounted = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "--lazy", str(folder)], check=True)


@contextmanager
def nearly_full(folder: Path, mounted: bool, free: int) -> Iterator[None]:
    """Leave so many bytes free."""
    if mounted:
        filler = folder / "filler"
        filler.write_bytes(bytes(max(shutil.disk_usage(folder).free - free, 0)))
        try:
            yield
        finally:
            filler.unlink()
    else:
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (free, hard))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def full_disks(disk: Path, whole: Path, expected: list[Row], times: int, draw: random.Random) -> Iterator[Outcome]:
    """Let commands write where little is free, over files that are there already; then again, with room."""
    with small_disk(disk) as mounted:
        drive, page, track = (str(disk / name) for name in ("drive.h5", "page.html", "track.geojson"))
        name = "a full disk (tmpfs)" if mounted else "a full disk (RLIMIT_FSIZE)"
        lines = {
            "record": ("record", "tiny", *SHORT, "--out", drive),
            "export": ("export", drive, "--format", "geojson", "--origin=55.7,13.2", "--out", track),
            "report": ("report", str(whole), "--out", page, "--worst", "0"),
            "run": ("run", "tiny", *SHORT, "--estimator", ESTIMATORS[0], "--no-figures", "--out", str(disk / "run")),
        }
        for title, line in lines.items():
            counts, wrong = Counter[str](), list[str]()
            outcome_of(*line, "--quiet")
            for _ in range(times):
                before = contents(disk)
                with nearly_full(disk, mounted, int(10 ** draw.uniform(*FREE_DECADES))):
                    status, _, err = outcome_of(*line, "--quiet")
                after = contents(disk)
                counts["done" if status == DONE else "one line"] += 1
                if status not in (DONE, WRONG, FAILED) or (status and err.count("\n") != 1):
                    wrong.append(f"status {status}: {err}")
                if status and title != "run" and after != before:
                    wrong.append("the file that was there is not as it was")
                if litter := [path for path in after if ".tmp" in path or "/." in path]:
                    wrong.append(f"litter: {litter}")
                if outcome_of(*line, "--quiet")[0] != DONE:
                    wrong.append("does not work with room either")
            yield Outcome(f"`{title}` on {name}", times, "0 files" if not wrong else "?", words_of(counts), (*wrong,))
        lost, counts, wrong = 0, Counter[str](), []
        for number in range(times):
            out = disk / f"sweep-{number}"
            line = tuple(words(*ESTIMATORS, out=str(out), trials=TRIALS, more=("--executor", "serial")))
            with nearly_full(disk, mounted, int(10 ** draw.uniform(*FREE_DECADES))):
                status, _, err = outcome_of(*line)
                there = rows(out) if stored(out) else []
            counts["done" if status == DONE else "one line"] += 1
            if status not in (DONE, WRONG) or (status and err.count("\n") != 1):
                wrong.append(f"status {status}: {err}")
            if outcome_of(*line)[0] == DONE:
                lost += sum(row not in rows(out) for row in (*there, *expected))
            else:
                wrong.append("does not go on with room")
                lost += len(expected)
            shutil.rmtree(out)
        rows_of = f"{lost} of {times * len(expected)} rows"
        yield Outcome(f"`sweep` on {name}, same command with room", times, rows_of, words_of(counts), (*wrong,))


def contents(folder: Path) -> dict[str, bytes]:
    """Return the files below a folder."""
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def words_of(counts: Counter[str]) -> str:
    """Return how often each was seen."""
    return ", ".join(f"{text}: {count}" for text, count in counts.most_common())


def changed(path: Path, draw: random.Random) -> None:
    """Change five bytes, each to another."""
    content = bytearray(path.read_bytes())
    for at in draw.sample(range(len(content)), 5):
        content[at] ^= draw.randrange(1, 256)
    path.write_bytes(content)


def cut(path: Path, draw: random.Random) -> None:
    """Keep a part, from the start."""
    content = path.read_bytes()
    path.write_bytes(content[: draw.randrange(len(content))])


def deleted(path: Path, draw: random.Random) -> None:
    """Delete it."""
    path.unlink()


DAMAGES: tuple[Callable[[Path, random.Random], None], ...] = (changed, cut, deleted)


def damaged_results(
    folder: Path, whole: Path, expected: list[Row], times: int, draw: random.Random
) -> Iterator[Outcome]:
    """Damage the database or a trajectory of a finished sweep; read it, then give the same command."""
    for what, wound in [(what, wound) for what in ("database", "trajectory") for wound in DAMAGES]:
        counts, wrong, lost = Counter[str](), list[str](), 0
        for number in range(times):
            out = folder / f"damaged-{what}-{wound.__name__}-{number}"
            shutil.copytree(whole, out)
            files = [out / DATABASE] if what == "database" else sorted((out / TRAJECTORIES).rglob("*.npz"))
            wound(draw.choice(files), draw)
            status, _, err = outcome_of("consistency" if what == "trajectory" else "table", str(out))
            same = suppressed(lambda: rows(out) == expected)  # noqa: B023
            if err.count("\n") > 1 or status not in (DONE, WRONG):
                wrong.append(f"status {status}: {err}")
            if not (same or status):
                wrong.append("other rows, and without a word to the user")
            if what == "trajectory" and "missing or damaged: 1" not in err:
                wrong.append("a lost trajectory, and without a word to the user")
            again = outcome_of(*words(*ESTIMATORS, out=str(out), trials=TRIALS, more=("--executor", "serial")))[0]
            restored = again == DONE and rows(out) == expected
            if not restored:
                lost += len(expected)
            reading = "read as before" if status == DONE and not err else "one line" if status else "a note"
            counts[f"{reading}, {'same command makes it whole' if restored else 'recover or sweep again'}"] += 1
            shutil.rmtree(out)
        rows_of = f"{lost} of {times * len(expected)} rows"
        yield Outcome(f"{what} of a sweep {wound.__name__}", times, rows_of, words_of(counts), (*wrong,))


def suppressed(action: Callable[[], bool]) -> bool:
    """Return what an action returns, False where it cannot."""
    try:
        return action()
    except Exception:
        return False


def damaged_files(folder: Path, times: int, draw: random.Random) -> Iterator[Outcome]:
    """Damage a recording, a map and a calibration; read each."""
    sound_ones = sound_files(folder / "sound")
    drive, learnt, field = (sound_ones[name].path for name in ("recording", "map", "calibration"))
    readers = {
        "recording": (drive, ("inspect",), ()),
        "map": (
            learnt,
            ("map", "join", str(shutil.copy(learnt, folder / "other.h5"))),
            ("--out", str(folder / "j.h5")),
        ),
        "calibration": (field, ("figures",), ("--out", str(folder / "figures"))),
    }
    for what, (file, first, last) in readers.items():
        sound, before = file.read_bytes(), outcome_of(*first, str(file), *last)
        for wound in DAMAGES:
            counts, wrong = Counter[str](), list[str]()
            for _ in range(times):
                wound(file, draw)
                found = outcome_of(*first, str(file), *last)
                file.write_bytes(sound)
                counts["read as before" if found == before else "one line"] += 1
                if found != before and (found[0] != WRONG or found[2].count("\n") != 1):
                    wrong.append(f"status {found[0]}: {found[1]}{found[2]}")
            yield Outcome(f"{what} {wound.__name__}", times, "this file", words_of(counts), (*wrong,))
