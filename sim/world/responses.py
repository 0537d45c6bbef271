"""Raw array responses of a drive: what the signal-level receiver estimates paths from, in a file beside the recording.

They are received again, from the same random numbers, so that nothing of a drive's simulation keeps gigabytes. Layout
of the file: that of TU Ilmenau's campaigns (`recordings/adapters/tui_files.py`), a chunk a snapshot and link.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
from threadpoolctl import threadpool_limits

from cellslam.sim.errors import InputError
from cellslam.sim.lte.signal.drive_in_blocks import snapshot_rng
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Floats
from cellslam.sim.world.world import World, WorldConfig, path_columns, prepare

GROUP = "FrequencyResponses"
COMPLEX = np.dtype([("real", "<f4"), ("imag", "<f4")])


def write_responses(path: Path, config: WorldConfig, seed: int, trial: int, progress: Progress = silent) -> None:
    """Write the responses of a trial's drive, in roots of mW, to an HDF5 file.

    `FrequencyResponses/Data` (snapshot, link, port of the array, tone): descrambled, other cells cancelled, delays
    counted from `MetaData/Tx/SyncDistance` (L,), m; array ports are sampled one after the other, at
    `MetaData/Rx/TimeOffset` (ports,), s. Raises InputError where the front end has no signals, or the file cannot be
    written.
    """
    world, temporary = prepare(config, seed, trial, progress), path.with_name(f".{path.name}.tmp")
    try:
        with threadpool_limits(1), h5py.File(temporary, "w", libver=("v108", "v108")) as file:
            _fill(file, world, progress)
        temporary.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        temporary.unlink(missing_ok=True)


def _fill(file: h5py.File, world: World, progress: Progress) -> None:
    signals, reports, drive = world.signals, world.reports(), world.drive
    if signals is None:
        raise InputError("responses are of the signal-level front end: --set radio.front_end=signal")
    poses, moment = world.measured_at(None if reports is None else reports.late_s)
    paths, blocked = world.trace(poses, moment, progress)
    columns = path_columns(paths.take(blocked.free(len(paths))), len(poses), len(world.sites_m))
    links, tones = len(signals.links.site), signals.waveform.tones_hz + world.config.radio.carrier_hz
    shape = (len(poses), links, signals.array.ports, len(tones))
    data = file.create_dataset(f"{GROUP}/Data", shape, COMPLEX, chunks=(1, 1, *shape[2:]))
    for dimension, label in zip(data.dims, ("Snapshot", "Tx", "Rx", "Frequency"), strict=True):
        dimension.label = label
    _write(file, "Snapshot/TimeStamp", drive.time_s, "s")
    _write(file, "Frequency/Frequency", tones, "Hz")
    _write(file, "Rx/TimeOffset", signals.receiver.times_s, "s")
    _write(file, "Tx/SyncDistance", signals.sync_m[signals.links.site], "m")
    for label, count in (("Tx", links), ("Rx", shape[2])):
        file[f"{GROUP}/MetaData/{label}/AntennaPortID"] = np.arange(count)
    rng = world.streams().noise
    with progress("responses", len(poses)) as advance:
        for t, pose in enumerate(poses):
            one, _ = columns.of_snapshots(t, t + 1, len(world.sites_m))
            own = snapshot_rng(rng, t)
            for link, samples in enumerate(signals.responses(one, pose, drive.velocity[t, :3], t, own)):
                data[t, link] = np.ascontiguousarray(samples, np.complex64).view(COMPLEX)
            advance(1)


def _write(file: h5py.File, name: str, values: Floats, unit: str) -> None:
    dataset: Any = file.create_dataset(f"{GROUP}/MetaData/{name}", data=values)
    dataset.attrs["BaseUnit"], dataset.attrs["UnitScaler"] = unit, 1.0
