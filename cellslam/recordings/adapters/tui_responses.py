"""Paths in frequency responses: our own estimator, with the array of the campaign's pattern file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellslam.recordings.adapters.tui_files import Responses, Sheet, complex_of, opened
from cellslam.recordings.importing.campaign import DEVIATIONS, QUANTITIES
from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, TURN
from cellslam.sim.lte.array import EadfArray, eadf_from_grid
from cellslam.sim.lte.signal.path_estimator.path_estimator import estimate_paths
from cellslam.sim.lte.signal.receiver import Receiver
from cellslam.sim.recording import Floats, Ints

GROUP, PATTERNS = "FrequencyResponses", "BeampatternData"
WINDOW = (-0.02, 0.95)  # of the unambiguous range: paths are looked for from, and to
COLUMNS = (*QUANTITIES, *DEVIATIONS)


def estimated(folder: Path, sheet: Sheet, asked: Responses) -> tuple[Floats, Floats, Ints, dict[str, Floats]]:
    """Return times of all snapshots (T,) in s; time (M,) in s, link (M,) and columns (M,) of the paths found in them.

    A link is one of `tx_ports`. Raises InputError naming file and data set.
    """
    with opened(folder / asked.file, sheet.units) as file:
        data, axes = file.dataset(f"{GROUP}/Data"), file.axes(f"{GROUP}/Data", asked.axes)
        missing = {"Tx", "Rx", "Frequency", "Snapshot"} - set(axes)
        if missing:
            raise InputError(
                f"{file.path}: {GROUP}/Data has no dimension {', '.join(sorted(missing))} (it has: {axes})"
            )
        tones = file.values(f"{GROUP}/MetaData/Frequency/Frequency")
        sent = file.ports(GROUP, "Tx")
        unknown = [port for port in asked.tx_ports if port not in sent]
        if unknown:
            raise InputError(f"{file.path}: no Tx port {unknown[0]} (it has: {', '.join(map(str, sent))})")
        array, turned = pattern_array(folder / asked.array, sheet, file.ports(GROUP, "Rx"), float(tones.mean()))
        receiver = _receiver(array, tones, asked.port_interval_s)
        times = file.values(f"{GROUP}/MetaData/Snapshot/TimeStamp")
        order = [axes.index(label) for label in ("Tx", "Rx", "Frequency")]
        motion = receiver.moving(np.zeros(3))
        rows, when, link = [], [], []
        for snapshot in range(0, len(times), asked.every):
            place = tuple(snapshot if label == "Snapshot" else slice(None) for label in axes)
            kept = [axis - (axis > axes.index("Snapshot")) for axis in order]
            block = complex_of(data[place]).transpose(kept)
            for number, port in enumerate(asked.tx_ports):
                found = estimate_paths(np.ascontiguousarray(block[sent.index(port)], np.complex128), motion)
                std = np.sqrt(np.einsum("nii->ni", found.covariance))
                rows.append(np.column_stack([found.geometry, found.snr_db, std]))
                when.append(np.full(len(found), times[snapshot]))
                link.append(np.full(len(found), number))
    table = np.concatenate(rows)
    table[:, 1] = np.radians(asked.array_azimuth.zero_deg) + asked.array_azimuth.sign * (table[:, 1] + turned)
    return times[:: asked.every], np.concatenate(when), np.concatenate(link), dict(zip(COLUMNS, table.T, strict=True))


def _receiver(array: EadfArray, tones: Floats, interval_s: float) -> Receiver:
    steps = np.diff(tones)
    if len(tones) < 2 or np.ptp(steps) > 1e-3 * abs(steps[0]):
        raise InputError("the frequencies of the responses are not evenly spaced: our estimator needs them so")
    reach = SPEED_OF_LIGHT_MPS / abs(float(steps[0]))
    return Receiver(
        array=array, times_s=interval_s * np.arange(array.ports, dtype=np.float64), carrier_hz=float(tones.mean()),
        tones_hz=tones, bandwidth_hz=len(tones) * abs(float(steps[0])), window_min_m=WINDOW[0] * reach,
        window_max_m=WINDOW[1] * reach,
    )  # fmt: skip


def pattern_array(path: Path, sheet: Sheet, ports: list[int], carrier_hz: float) -> tuple[EadfArray, float]:
    """Return the array of a pattern file, its `ports` in this order, and the azimuth (rad) at which its grid begins.

    Raises InputError where the patterns do not cover the sphere evenly, or are of other ports.
    """
    with opened(path, sheet.units) as file:
        place = f"{PATTERNS}/Data"
        azimuth = file.values(f"{PATTERNS}/MetaData/Azimuth/AzimuthAngle")
        elevation = file.values(f"{PATTERNS}/MetaData/Elevation/ElevationAngle")
        frequency = file.values(f"{PATTERNS}/MetaData/Frequency/Frequency")
        own = file.ports(PATTERNS, "Port")
        if sorted(own) != sorted(ports):
            raise InputError(f"{path}: its ports are {own}, those of the responses {ports}: another array?")
        labels = ("Port", "RefPolarization", "Elevation", "Azimuth", "Frequency")
        axes = file.axes(place, ("Elevation", "Azimuth", "Frequency", "RefPolarization", "Port"))
        if set(axes) != set(labels):
            raise InputError(f"{path}: {place} has the dimensions {', '.join(axes)}, expected {', '.join(labels)}")
        whole = complex_of(file.dataset(place)[()]).transpose([axes.index(label) for label in labels])
    patterns = whole[..., int(np.argmin(np.abs(frequency - carrier_hz)))]
    patterns = patterns[[own.index(port) for port in ports]][:, :, np.argsort(elevation)]
    if not np.allclose(np.sort(elevation), np.linspace(-np.pi / 2, np.pi / 2, len(elevation)), atol=1e-3):
        raise InputError(f"{path}: its elevations do not go evenly from -90 to 90 degrees")
    if np.isclose(abs(azimuth[-1] - azimuth[0]), TURN, atol=1e-3):
        azimuth, patterns = azimuth[:-1], patterns[..., :-1]
    if azimuth[-1] < azimuth[0]:
        azimuth, patterns = azimuth[::-1], patterns[..., ::-1]
    if not np.allclose(azimuth, azimuth[0] + TURN * np.arange(len(azimuth)) / len(azimuth), atol=1e-3):
        raise InputError(f"{path}: its azimuths do not go evenly round a turn")
    return eadf_from_grid(np.ascontiguousarray(patterns)), float(azimuth[0])
