"""A drive at signal level, in blocks of snapshots: several processes, progress, restart where a run was stopped.

Source: own, docs/how-to/drive-from-signals.md.
"""

from __future__ import annotations

import hashlib
import io
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
from threadpoolctl import threadpool_limits

from cellslam.sim.compiling import cache_folder
from cellslam.sim.files import private_folder, write_durably
from cellslam.sim.lte.signal.block_processes import in_processes
from cellslam.sim.lte.signal.signal_front_end import SignalLevel
from cellslam.sim.lte.statistical import detector_layout as k
from cellslam.sim.lte.statistical.detector_layout import PathColumns
from cellslam.sim.lte.statistical.statistical_front_end import Detections, detections_of
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Floats

BLOCK = 50
FEWEST_SHARED = 4  # blocks for which starting processes pays


def detect_signals(
    front_end: SignalLevel, paths: PathColumns, poses: Floats, velocities: Floats, odometry: Floats,
    rng: np.random.Generator, first_snapshot: int = 0, trial_key: str = "", progress: Progress = silent,
) -> Detections:  # fmt: skip
    """Return the measurements of `poses` (T, 6), whose paths are `paths`, numbered from `first_snapshot`.

    `velocities`, `odometry` (T, 6), m/s first: true body velocities, and those that the receiver compensates Doppler
    with. Every snapshot has a generator of its own, a child of `rng` by its number. With a `trial_key` (what decides
    the result), finished blocks are kept in the folder for temporary files until the drive is whole, and taken from
    there.
    """
    starts, out = range(0, len(poses), BLOCK), []
    with _kept_blocks(trial_key) as folder, threadpool_limits(1), progress("measuring signals", len(poses)) as advance:
        blocks = _Blocks(front_end, paths, poses, velocities, odometry, rng, first_snapshot, BLOCK, folder)
        for start, table in zip(starts, _worked_off(blocks, starts), strict=True):
            out.append(table)
            advance(min(BLOCK, len(poses) - start))
    return detections_of(np.concatenate([np.empty((0, k.COLUMNS)), *out]))


def _worked_off(blocks: _Blocks, starts: range) -> Iterator[Floats]:
    """Yield the blocks in order; where there are many, as many processes work ahead as kernels may have threads."""
    processes = min(int(numba.config.NUMBA_NUM_THREADS), len(starts))  # type: ignore[attr-defined]
    if processes < 2 or len(starts) < FEWEST_SHARED:
        yield from map(blocks, starts)
    else:
        yield from in_processes(blocks, starts, processes)


@dataclass(frozen=True)
class _Blocks:
    """What each block of a drive is measured from; see `detect_signals`. `folder` keeps finished ones."""

    front_end: SignalLevel
    paths: PathColumns
    poses: Floats
    velocities: Floats
    odometry: Floats
    rng: np.random.Generator
    first_snapshot: int
    length: int
    folder: Path | None

    def __call__(self, start: int) -> Floats:
        """Return the block that begins with row `start` from its file, or measure it and keep it."""
        if self.folder is None:
            return self._measured(start)
        file = self.folder / f"{start:07d}.block"
        table = _kept(file)
        if table is None:
            table = self._measured(start)
            _keep(file, table)
        return table

    def _measured(self, start: int) -> Floats:
        rows = [np.empty((0, k.COLUMNS))]
        for t in range(start, min(start + self.length, len(self.poses))):
            one, low = self.paths.of_snapshots(t, t + 1, len(self.front_end.offsets_m))
            number = self.first_snapshot + t
            own = snapshot_rng(self.rng, number)
            velocity, odometry = self.velocities[t, :3], self.odometry[t, :3]
            table = self.front_end.measure(one, self.poses[t], velocity, odometry, number, own)
            table[:, k.PATH] += np.where(table[:, k.PATH] >= 0.0, low, 0)
            rows.append(table)
        return np.concatenate(rows)


def _keep(file: Path, table: Floats) -> None:
    """Keep a finished block, its digest before it; on a full disk it is not kept."""
    stream = io.BytesIO()
    np.save(stream, table)
    with suppress(OSError):
        file.parent.mkdir(exist_ok=True, mode=0o700)  # another run of the trial may have removed it
        write_durably(file, hashlib.sha256(stream.getvalue()).digest() + stream.getvalue())


def _kept(file: Path) -> Floats | None:
    """Return a block that was kept; None where there is none, or it is not what was written."""
    content = file.read_bytes() if file.exists() else b""
    size = hashlib.sha256().digest_size
    if hashlib.sha256(content[size:]).digest() != content[:size]:
        return None
    return np.asarray(np.load(io.BytesIO(content[size:])), np.float64)


def snapshot_rng(rng: np.random.Generator, number: int) -> np.random.Generator:
    """Return the generator of a snapshot: it depends on how `rng` was seeded, not on what was drawn from it."""
    parent = rng.bit_generator.seed_seq
    assert isinstance(parent, np.random.SeedSequence)
    return np.random.default_rng(np.random.SeedSequence(parent.entropy, spawn_key=(*parent.spawn_key, number)))


@contextmanager
def _kept_blocks(trial_key: str) -> Iterator[Path | None]:
    """Yield the folder of a trial's finished blocks; it goes when the trial is whole, and stays when it is not. Other
    sources, which may measure the same trial otherwise, have another. None where others could write into it.
    """
    private = private_folder("signals") if trial_key else None
    if private is None:
        yield None
        return
    sources = cache_folder(__name__, Path(__file__)).name
    name = hashlib.sha256(f"{sources} {trial_key}".encode()).hexdigest()[:24]
    folder = private / name
    yield folder
    shutil.rmtree(folder, ignore_errors=True)
