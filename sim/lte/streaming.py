"""A drive at signal level, in blocks of snapshots: two threads, progress, and a restart where a run was interrupted."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from cellslam.sim.lte import detector_model as k
from cellslam.sim.lte.signal_level import SignalLevel
from cellslam.sim.lte.statistical import Detections, PathColumns, detections_of
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Floats

BLOCK = 50
# Part of the name of kept blocks: grows when the same trial would be measured otherwise.
REVISION = 4


def detect_signals(
    front_end: SignalLevel, paths: PathColumns, poses: Floats, velocities: Floats, odometry: Floats,
    rng: np.random.Generator, first_snapshot: int = 0, trial_key: str = "", progress: Progress = silent,
) -> Detections:  # fmt: skip
    """Return the measurements of `poses` (T, 6), whose paths are `paths`, numbered from `first_snapshot`.

    `velocities`, `odometry` (T, 3 or 6): true body velocities, and those that the receiver compensates Doppler with.
    Every snapshot has a generator of its own, a child of `rng` by its number. With a `trial_key` (what decides the
    result), finished blocks are kept in the folder for temporary files until the drive is whole, and taken from there.
    """
    sites = len(front_end.offsets_m)

    def block(start: int) -> Floats:
        rows = [np.empty((0, k.COLUMNS))]
        for t in range(start, min(start + BLOCK, len(poses))):
            one, low = snapshot_paths(paths, t, sites)
            own = snapshot_rng(rng, first_snapshot + t)
            table = front_end.measure(one, poses[t], velocities[t, :3], odometry[t, :3], first_snapshot + t, own)
            table[:, k.PATH] += np.where(table[:, k.PATH] >= 0.0, low, 0)
            rows.append(table)
        return np.concatenate(rows)

    starts, out = range(0, len(poses), BLOCK), []
    with _kept_blocks(trial_key) as folder, threadpool_limits(1), progress("measuring signals", len(poses)) as advance:
        for start, table in zip(starts, _worked_off(lambda s: _resumed(folder, s, block), starts), strict=True):
            out.append(table)
            advance(min(BLOCK, len(poses) - start))
    return detections_of(np.concatenate([np.empty((0, k.COLUMNS)), *out]))


def _worked_off(block: Callable[[int], Floats], starts: range) -> Iterator[Floats]:
    """Yield the blocks in order, several threads working ahead; one block takes no thread."""
    if len(starts) < 2:
        yield from map(block, starts)
        return
    pool = ThreadPoolExecutor(os.cpu_count() or 1)
    try:
        yield from pool.map(block, starts)
    finally:
        pool.shutdown(cancel_futures=True)


def snapshot_paths(paths: PathColumns, t: int, sites: int) -> tuple[PathColumns, int]:
    """Return the paths of one snapshot, and the row of the first."""
    rows = paths.rows[t * sites : (t + 1) * sites + 1]
    low, high = int(rows[0]), int(rows[-1])
    return PathColumns(rows - low, paths.vt_m[low:high], paths.gain[low:high], paths.departure_rad[low:high]), low


def snapshot_rng(rng: np.random.Generator, number: int) -> np.random.Generator:
    """Return the generator of a snapshot: it depends on how `rng` was seeded, not on what was drawn from it."""
    parent = rng.bit_generator.seed_seq
    assert isinstance(parent, np.random.SeedSequence)
    return np.random.default_rng(np.random.SeedSequence(parent.entropy, spawn_key=(*parent.spawn_key, number)))


def _resumed(folder: Path | None, start: int, block: Callable[[int], Floats]) -> Floats:
    """Return a block from its file, or measure it and keep it."""
    if folder is None:
        return block(start)
    file = folder / f"{start:07d}.npy"
    if file.exists():
        return np.asarray(np.load(file), np.float64)
    table: Floats = block(start)
    partial = file.with_suffix(f".{os.getpid()}.tmp")
    with partial.open("wb") as stream:
        np.save(stream, table)
    partial.replace(file)
    return table


@contextmanager
def _kept_blocks(trial_key: str) -> Iterator[Path | None]:
    """Yield the folder of a trial's finished blocks; it goes when the trial is whole, and stays when it is not."""
    if not trial_key:
        yield None
        return
    from importlib.metadata import version

    name = hashlib.sha256(f"{REVISION} {version('cellslam')} {trial_key}".encode()).hexdigest()[:24]
    folder = Path(tempfile.gettempdir()) / f"cellslam-{os.getuid() if hasattr(os, 'getuid') else 0}" / f"signal-{name}"
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    yield folder
    shutil.rmtree(folder, ignore_errors=True)
