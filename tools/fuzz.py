"""Damage files of every kind and read them: each is refused in one line, or read, in time and in memory.

What is read is the same as before the damage; or it is what the file says now, where a file has no seal: nobody can
know that a digit of a table was another.

A process reads case after case; one that crashes, or takes too long, is replaced. A failure names its case, which
`--first N --cases 1` shows again.
"""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import resource
import tempfile
import time
import traceback
import warnings
from argparse import ArgumentParser, Namespace
from collections import Counter
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from cellslam.cli.arguments import DONE, FAILED

OUTCOMES = ("refused", "the same", "as it says")
LIMIT_S = 10.0  # of processor time that reading one file may take
HANG_S = 120.0  # without an answer, on a machine that others use, too
LIMIT_BYTES = 2**30  # that reading one file may take


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this tool."""
    parser.add_argument("--cases", type=int, default=3000, help="how many files (default: 3000)")
    parser.add_argument("--first", type=int, default=0, help="number of the first case (default: 0)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the damage (default: 0)")


def command(arguments: Namespace) -> int:
    """Read the damaged files; print what came out by kind, and each failure."""
    with tempfile.TemporaryDirectory() as name:
        counts: Counter[tuple[str, str]] = Counter()
        failures = []
        case, end = arguments.first, arguments.first + arguments.cases
        while case < end:
            here, there = multiprocessing.Pipe()
            worker = multiprocessing.get_context("spawn").Process(
                target=_read_on, args=(there, Path(name), arguments.seed, case, end)
            )
            worker.start()
            there.close()
            sound: list[str] = here.recv()
            while case < end:
                kind = sound[case % len(sound)]
                try:
                    answer = here.recv() if here.poll(HANG_S) else f"no end within {HANG_S:g} s"
                    lost = answer.startswith("no end")
                except EOFError:
                    answer, lost = "the process crashed", True
                outcome = answer if answer in OUTCOMES else "FAILED"
                counts[kind, outcome] += 1
                if outcome == "FAILED":
                    failures.append(f"case {case}, {kind}: {answer}")
                    print(failures[-1], flush=True)
                case += 1
                if lost:
                    break
            worker.kill()
            worker.join()
    for kind in sorted({kind for kind, _ in counts}):
        print(f"{kind:24}" + "".join(f"{counts[kind, o]:6d} {o}" for o in (*OUTCOMES, "FAILED")))
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = f"{used.ru_utime + used.ru_stime:.0f} s of processor time"
    print(f"{sum(counts.values())} files, {len(failures)} failures, {spent}")
    return FAILED if failures else DONE


def _read_on(answers: Connection, folder: Path, seed: int, case: int, end: int) -> None:
    """Read the sound files, which compiles, and send their kinds; then read all cases from `case` on, and send of each
    one of `OUTCOMES`, or how it failed."""
    from tests.damaged_files import damage_copy, read, sound_files

    kinds = sound_files(folder / f"sound-{case}")
    sound = list(kinds.values())
    before = [kind.read(kind.path) for kind in sound]
    answers.send(list(kinds))
    faulthandler.disable()
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 2)
    pages = int(Path("/proc/self/statm").read_text().split()[5]) if Path("/proc/self/statm").exists() else 0
    limit = pages * os.sysconf("SC_PAGE_SIZE") + LIMIT_BYTES
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    for number in range(case, end):
        kind, path = sound[number % len(sound)], sound[number % len(sound)].path
        rng = np.random.default_rng([seed, number])
        begin = time.process_time()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                damaged = damage_copy(path, folder / "damaged" / path.parent.name, rng)
                answer = read(damaged, kind, before[number % len(sound)])
        except BaseException as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            answer = f"{type(error).__name__}: {str(error)[:200]!r} ({Path(last.filename).name}, line {last.lineno})"
        spent = time.process_time() - begin
        answers.send(answer if spent < LIMIT_S else f"took {spent:.0f} s of processor time")
