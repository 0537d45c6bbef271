"""Job scripts that carry out a sweep in shards: arrays of Slurm and PBS, GNU parallel on a list of hosts.

Sources: https://slurm.schedmd.com/job_array.html; qsub(1B) of PBS Professional; parallel(1).
"""

from __future__ import annotations

import math
import shlex
import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from cellslam.benchmarks.sweeps.watch import clock
from cellslam.benchmarks.trials.child_process import ONE_THREAD

# Of 10 to 60 minutes: starting costs little beside it, little is lost with a job, and queues like short ones.
SHARD_S = 1800.0
MOST_SHARDS = 1000  # Slurm takes arrays up to there unless its administrator says otherwise (MaxArraySize)
MEMORY_GIB, DRIVER_GIB = 3.0, 1.0  # of the process that works, unless --memory-limit says so; of the one beside it
HEADS = {
    "slurm": """\
#SBATCH --job-name=cellslam --array=1-{count}
#SBATCH --ntasks=1 --cpus-per-task=1 --mem={memory_mb}M --time={time}
#SBATCH --requeue --open-mode=append
""",
    "pbs": """\
#PBS -N cellslam -J 1-{count}
#PBS -l select=1:ncpus=1:mem={memory_mb}mb -l walltime={time}
#PBS -r y -j oe
""",
    "parallel": "",
}
INDEX = {"slurm": '"$SLURM_ARRAY_TASK_ID"', "pbs": '"$PBS_ARRAY_INDEX"', "parallel": "{}"}
SUBMIT = {"slurm": "sbatch FILE", "pbs": "qsub FILE", "parallel": "bash FILE HOSTFILE (a host a line; none: here)"}


def script(arguments: Namespace, tasks: int, seconds: float, out: Path) -> str:
    """Return the script that `--script` asks for, of so many tasks, of which `seconds` of a core are left to do."""
    kind = arguments.script
    # PBS knows no array of one.
    count = max(min(math.ceil(seconds / SHARD_S), tasks, MOST_SHARDS), 2 if kind == "pbs" else 1)
    minutes = math.ceil(2.0 * seconds / count / 60.0) + 10  # others are slower, and the first compiles
    limit = arguments.memory_limit or MEMORY_GIB
    head = HEADS[kind].format(
        count=count, memory_mb=round(1024 * (limit + DRIVER_GIB)), time=f"{minutes // 60:02}:{minutes % 60:02}:00"
    )
    pinned = " ".join(f"{name}={value}" for name, value in ONE_THREAD.items())
    whole = shlex.join([*whole_command(arguments.words), "--jobs", "1", "--memory-limit", f"{limit:g}"])
    lines = [
        f'export PATH={shlex.quote(str(Path(sys.executable).parent))}:"$PATH" {pinned}',
        f"cd {shlex.quote(str(Path.cwd()))} || exit",
        f"exec {whole} --shard {INDEX[kind]}/{count}",
    ]
    if kind == "parallel":
        lines = [f'seq {count} | parallel ${{1:+--sshloginfile "$1"}} --retries 3 {shlex.quote("; ".join(lines))}']
    about = f"{count} shards of about {clock(seconds / count)} on a core; what was killed goes on when it is repeated"
    then = f"cellslam watch {shlex.quote(str(out))}, then cellslam merge {shlex.quote(str(out))}"
    return "\n".join(["#!/bin/bash", *head.splitlines(), f"# {about}", f"# {SUBMIT[kind]}, then {then}", *lines, ""])


def whole_command(words: Sequence[str]) -> list[str]:
    """Return a command line, with the name of the program, less what asks for a shard or a script."""
    kept, skip = ["cellslam"], False
    for word in words:
        if not skip and not word.startswith(("--shard=", "--script=")) and word not in ("--shard", "--script"):
            kept.append(word)
        skip = word in ("--shard", "--script")
    return kept
