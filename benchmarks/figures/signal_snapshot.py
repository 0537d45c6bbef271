"""One snapshot at signal level: delay-azimuth spectra, the true paths, the paths found and the ghosts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cellslam.benchmarks.figures import style
from cellslam.sim.errors import InputError
from cellslam.sim.lte.signal.drive_in_blocks import snapshot_rng
from cellslam.sim.lte.signal.path_estimator.spectrum import Spectrum
from cellslam.sim.lte.signal.receiver import AZIMUTHS, ELEVATIONS
from cellslam.sim.lte.signal.signal_front_end import true_geometry
from cellslam.sim.lte.statistical import detector_layout as k
from cellslam.sim.recording import Floats
from cellslam.sim.world import World, path_columns

SHOWN = 4
MARGIN_M = 60.0


def draw_snapshot(world: World, number: int, link: int | None, out: Path) -> list[str]:
    """Draw the snapshot to `out` (.png) and return a line of text per link shown. Raises InputError for a link that
    does not exist.
    """
    signals = world.signals
    assert signals is not None
    links = len(signals.links.site)
    if link is not None and not 0 <= link < links:
        raise InputError(f"--link {link}: the scenario has links 0 to {links - 1}")
    pose, velocity = world.drive.poses[number], world.drive.velocity[number, :3]
    columns = path_columns(world.free_paths(pose[None], np.array([number])), 1, len(world.sites_m))
    noise = world.streams().noise
    table = signals.measure(columns, pose, velocity, velocity, number, snapshot_rng(noise, number))
    slots = signals.slots(number)
    received = signals.receive(columns, pose, velocity, number, slots, snapshot_rng(noise, number))
    truth = true_geometry(columns, pose)
    counts = np.bincount(table[:, k.LINK].astype(int), minlength=links)
    shown = [link] if link is not None else sorted(np.argsort(-counts, kind="stable")[:SHOWN].tolist())
    figure, lines = Figure(layout="constrained"), []
    axes = style.panels(figure, len(shown), min(len(shown), 2), (11.0, 4.2))
    for axis, one in zip(axes, shown, strict=True):
        spectrum = Spectrum(
            signals.receiver.at_distances(signals.samples(one, received, slots)), signals.receiver.moving(velocity)
        )
        spectrum.evaluate()
        site = int(signals.links.site[one])
        true = truth[int(columns.rows[site]) : int(columns.rows[site + 1])]
        found = table[table[:, k.LINK] == one]
        clock = float(signals.offsets_m[site])
        _panel(axis, spectrum, true, found, clock, clock - float(signals.sync_m[site]))
        cell, port = signals.name(one)
        axis.set_title(f"link {one}: site {world.config.sites[site].name}, cell {cell}, port {port}", fontsize=10)
        real = int((found[:, k.PATH] >= 0).sum())
        lines.append(f"link {one}: {len(true)} true paths, {real} found, {len(found) - real} reported besides")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=9)
    figure.suptitle(f"snapshot {number} at {world.drive.time_s[number]:.1f} s: strongest direction over noise, dB")
    figure.savefig(out, dpi=80)
    return lines


def _panel(axis: Any, spectrum: Spectrum, true: Floats, found: Floats, clock_m: float, ahead_m: float) -> None:
    """Draw one link; lengths without the clock offset. `ahead_m`: by how much the window's zero is early."""
    level = spectrum.power.energy.reshape(AZIMUTHS, ELEVATIONS, -1).max(axis=1) / spectrum.power.noise
    azimuth = np.degrees(2.0 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS - np.pi)
    length = spectrum.motion.receiver.delays_m - ahead_m
    picture = axis.pcolormesh(
        length, azimuth, 10.0 * np.log10(np.maximum(level, 1e-3)), vmin=5.0, vmax=40.0, cmap="Greys", shading="nearest",
        rasterized=True,
    )  # fmt: skip
    axis.figure.colorbar(picture, ax=axis, pad=0.01)
    real = found[:, k.PATH] >= 0.0
    lengths = np.concatenate([true[:, 0], found[:, k.DISTANCE] - clock_m, [100.0]])
    axis.plot(true[:, 0], np.degrees(true[:, 1]), "o", ms=13, mfc="none", mec=style.BLUE, mew=1.6, label="true path")
    for mask, mark, colour, label in (
        (real, "x", style.GREEN, "found"),
        (~real, "s", style.VERMILLION, "ghost or diffuse"),
    ):
        axis.plot(
            found[mask, k.DISTANCE] - clock_m, np.degrees(found[mask, k.AZIMUTH]), mark, ms=8, mew=1.6,
            mfc="none", mec=colour, label=label,
        )  # fmt: skip
    axis.set(
        xlim=(max(lengths.min() - MARGIN_M, length[0]), min(lengths.max() + MARGIN_M, length[-1])),
        ylim=(-180.0, 180.0), yticks=[-180, -90, 0, 90, 180],
        xlabel="path length (m)", ylabel="azimuth in the body frame (deg)",
    )  # fmt: skip
