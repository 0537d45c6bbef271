"""Signal-level front end: received reference symbols of every snapshot, and the paths that the receiver finds in them.

Snapshots are independent of each other, so that a drive can be measured in blocks, in any order: the receiver acquires
every snapshot again.

Source: the extended FastSLAM paper, section II, equations 2 to 5; own, docs/explanation/front-end.md, "Channel" and
"Estimator".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, azimuth_elevation, world_to_body, wrap_angle
from cellslam.sim.lte.array import CircularArray, Complex, ComplexSingle, PathSet, array_at, miscalibrated
from cellslam.sim.lte.links import Cells, link_table, slant
from cellslam.sim.lte.persisting_errors import floors
from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.lte.signal import symbol
from cellslam.sim.lte.signal.channel import SCATTERERS, Surroundings, arriving_paths
from cellslam.sim.lte.signal.path_estimator.cancellation import cancel
from cellslam.sim.lte.signal.path_estimator.path_estimator import Estimates, estimate_paths
from cellslam.sim.lte.signal.receiver import Motion, Receiver, phase_rate, receiver_of
from cellslam.sim.lte.statistical import detector_layout as k
from cellslam.sim.lte.statistical.detector_layout import PathColumns
from cellslam.sim.lte.statistical.measurement_kernel import Fields, write_attitude, write_persisting
from cellslam.sim.randomness import Stream, stream
from cellslam.sim.recording import Floats, Ints
from cellslam.sim.waveform.waveform import Waveform

SNAPSHOT_S = 0.075
# An estimate within this of a true path, in the sense of squares, comes from it: half a resolution cell of LTE.
SAME_PATH = 2.0 * np.array([4.6, np.radians(7.7), np.radians(8.0)])
# Calibration errors of the array, by port; errors of the sites' carriers.
PHASE_STD_DEG, GAIN_STD_DB = 5.0, 0.5
CARRIER_OFFSET_STD_HZ = 0.03


class Elements(NamedTuple):
    """Elements (ports, tones) of a comb: `value` in roots of mW; `variance` in mW of either part of the noise."""

    value: ComplexSingle
    variance: NDArray[np.float32]


@dataclass(frozen=True)
class SignalLevel:
    """One trial's air interface and receiver. `offsets_m` (S,) of the sites' clocks; `carrier_offsets_hz` (S,)."""

    config: RadioConfig
    waveform: Waveform
    cells: Cells
    offsets_m: Floats
    carrier_offsets_hz: Floats
    fields: Fields
    surroundings: Surroundings
    array: CircularArray
    receiver: Receiver

    @cached_property
    def links(self) -> k.LinkTable:
        """The links as the detector knows them."""
        return link_table(self.cells)

    @cached_property
    def combs(self) -> Ints:
        """The comb (L,) of reference elements that each link is sent on."""
        names = [self.name(link) for link in range(len(self.links.site))]
        return np.array(self.waveform.combs(names), np.int64)

    @cached_property
    def sync_m(self) -> Floats:
        """Where the receiver's search for cells places each site's delay window (S,): its clock, to a sample."""
        sample = SPEED_OF_LIGHT_MPS * self.waveform.sample_s
        return np.asarray(np.rint(self.offsets_m / sample) * sample, np.float64)

    @cached_property
    def floors(self) -> Floats:
        """The floors (3,) of the errors in m, rad, rad."""
        return floors(self.config)

    def name(self, link: int) -> tuple[int, int]:
        """Return cell ID and antenna port of a link."""
        return int(self.cells.cell_id[self.links.cell[link]]), int(self.links.port[link])

    def measure(
        self, paths: PathColumns, pose: Floats, velocity_mps: Floats, odometry_mps: Floats, snapshot: int,
        rng: np.random.Generator,
    ) -> Floats:  # fmt: skip
        """Return the measurements (M, COLUMNS), m, rad, dB, of one snapshot, whose traced paths are `paths`.

        `velocity_mps` (3,) of the body is true, `odometry_mps` (3,) what the receiver compensates Doppler with.
        """
        truth = true_geometry(paths, pose)
        motion = self.receiver.moving(odometry_mps)
        rows = []
        for link, samples in enumerate(self.responses(paths, pose, velocity_mps, snapshot, rng)):
            site = int(self.links.site[link])
            found = estimate_paths(samples, motion)
            own = slice(int(paths.rows[site]), int(paths.rows[site + 1]))
            rows.append(self.rows(snapshot, link, found, truth[own], own.start))
        return np.concatenate(rows)

    def responses(
        self, paths: PathColumns, pose: Floats, velocity_mps: Floats, snapshot: int, rng: np.random.Generator
    ) -> Iterator[ComplexSingle]:
        """Yield what paths are estimated from: of each link the `samples` (ports, tones) of a snapshot, in roots of mW.

        Arguments as of `measure`: with the same generator they are those that it has.
        """
        slots = self.slots(snapshot)
        received = self.receive(paths, pose, velocity_mps, snapshot, slots, rng)
        return (self.samples(link, received, slots) for link in range(len(self.links.site)))

    def receive(
        self, paths: PathColumns, pose: Floats, velocity_mps: Floats, snapshot: int, slots: Ints,
        rng: np.random.Generator,
    ) -> dict[int, ComplexSingle]:  # fmt: skip
        """Return the elements (ports, tones), in roots of mW, on every comb of reference elements in use."""
        sites = len(self.offsets_m)
        scattered = self.surroundings.add(paths, pose[:3])
        shape = (self.array.ports, len(self.waveform.tones_hz))
        own = np.float32(0.5 * self.config.noise_mw())
        total = {
            int(comb): Elements(np.zeros(shape, np.complex64), np.full(shape, own)) for comb in np.unique(self.combs)
        }
        for site in range(sites):
            rows = slice(int(scattered.rows[site]), int(scattered.rows[site + 1]))
            if rows.stop > rows.start:
                self._send(site, scattered, rows, pose, velocity_mps, snapshot, slots, total, rng)
        for value, variance in total.values():
            symbol.add_noise(value, variance, rng.standard_normal((*shape, 2), np.float32))
        return {comb: elements.value for comb, elements in total.items()}

    def _send(
        self, site: int, paths: PathColumns, rows: slice, pose: Floats, velocity_mps: Floats, snapshot: int,
        slots: Ints, total: dict[int, Elements], rng: np.random.Generator,
    ) -> None:  # fmt: skip
        """Add what every cell of a site sends to the elements `total`."""
        config = self.config
        one = np.ones(rows.stop - rows.start)
        arriving = [
            arriving_paths(pose, paths.vt_m[rows], paths.gain[rows], slant(np.array(port)), one, config.carrier_hz)
            for port in range(2)
        ]
        geometry = self._perturbed(arriving[0], paths.vt_m[rows], pose, snapshot)
        length = geometry[:, 0] + self.offsets_m[site]
        later = self.receiver.times_s - self.receiver.times_s.mean()
        drift = np.exp(2j * np.pi * self.carrier_offsets_hz[site] * later)
        steering = self._seen(velocity_mps, drift).steer(geometry[:, 1].copy(), geometry[:, 2].copy()).value
        on_ports = [np.einsum("npq,nq->pn", steering, p.weights).astype(np.complex64) for p in arriving]
        sums = symbol.PathSums(length, self.waveform.tones_hz)
        # What other cells' data add is noise-like: of diffuse energy only the power counts there.
        together = self.surroundings.scatterers + 1
        whole = np.sqrt(1.0 + 10.0 ** (-config.specular_to_diffuse_db / 10.0))
        for link in np.flatnonzero(self.links.site == site):
            cell = int(self.links.cell[link])
            off, down = (paths.departure_rad[rows] - [self.cells.azimuth_rad[cell], 0.0]).T
            sector_db = config.sector_gain_db(off, down, float(self.cells.tilt_rad[cell]))
            amplitude = 10.0 ** ((config.eirp_dbm + sector_db) / 20.0)
            weights = on_ports[int(self.links.port[link]) % 2]
            own = {int(self.combs[other]) for other in np.flatnonzero(self.links.cell == cell)}
            for comb, (value, variance) in total.items():
                shift = -2j * np.pi * comb * self.waveform.comb_step_hz / SPEED_OF_LIGHT_MPS
                turn = (amplitude * np.exp(shift * length)).astype(np.complex64)
                if comb == self.combs[link]:
                    response, evm = sums.of(weights * turn), config.evm * np.sqrt(0.5)
                    symbol.add_pilots(value, variance, response, self.sent[link], slots, evm)
                elif comb not in own and config.load > 0.0:
                    response = sums.of_every(together, weights[:, ::together] * turn[::together])
                    words = rng.bit_generator.random_raw(-(-value.size // 4)).view(np.uint16)[: value.size]
                    share = float(whole / np.sqrt(self.cells.ports[cell]))
                    symbol.add_data(value, response, words.reshape(value.shape), config.load, share)

    def _seen(self, velocity_mps: Floats, drift: Complex) -> Motion:
        """Return the array as it is, in motion with `velocity_mps` (3,), a carrier turning by `drift` (ports,)."""
        factor = drift if self.array.calibration is None else drift * self.array.calibration
        return Motion(self.receiver, velocity_mps, np.asarray(factor, np.complex128))

    def _perturbed(self, arriving: PathSet, vt_m: Floats, pose: Floats, snapshot: int) -> Floats:
        """Return distance, azimuth and elevation (n, 3) with the errors of roof, attitude and group delay.

        A path's scatterers share its errors.
        """
        attitude, error = np.empty(3), np.empty(3)
        write_attitude(snapshot, self.fields, attitude)
        geometry = np.stack([arriving.distance_m, arriving.azimuth_rad, arriving.elevation_rad], 1)
        together = self.surroundings.scatterers + 1
        for first in range(0, len(geometry), together):
            write_persisting(geometry[first], pose, vt_m[first], 0, attitude, self.fields, error)
            geometry[first : first + together] += error
        geometry[:, 2] = np.clip(geometry[:, 2], -1.5, 1.5)
        return geometry

    @cached_property
    def sent(self) -> ComplexSingle:
        """The reference values (L, slots, tones) of every link."""
        combs = self.combs.tolist()
        return np.array([
            [self.waveform.values(self.name(link), comb, slot) for slot in range(self.waveform.slots)]
            for link, comb in enumerate(combs)
        ], np.complex64)  # fmt: skip

    def slots(self, snapshot: int) -> Ints:
        """Return the slot of the frame in which each array port is sampled (ports,)."""
        first, slot_s = round(SNAPSHOT_S / self.waveform.slot_s) * snapshot, self.waveform.slot_s
        return np.asarray(
            (first + np.rint(self.receiver.times_s / slot_s).astype(np.int64)) % self.waveform.slots, np.int64
        )

    def samples(self, link: int, received: dict[int, ComplexSingle], slots: Ints) -> ComplexSingle:
        """Return a link's descrambled samples (ports, tones), colliding cells cancelled, delays counted from its site's
        synchronisation.
        """
        site, comb = int(self.links.site[link]), int(self.combs[link])
        later = np.exp(1j * phase_rate(self.waveform.tones_hz) * self.sync_m[site]).astype(np.complex64)
        y: ComplexSingle = received[comb] * (self.sent[link].conj() * later)[slots]
        for other in np.flatnonzero(self.combs == comb):
            if other != link:
                apart = float(self.sync_m[self.links.site[other]] - self.sync_m[site])
                y = cancel(y, self.waveform, self.name(link), self.name(int(other)), comb, slots, apart)
        return y

    def rows(self, snapshot: int, link: int, found: Estimates, truth: Floats, first: int) -> Floats:
        """Return a link's measurements (n, COLUMNS), m, rad, dB: claimed deviations are those of the fit and the
        floors.
        """
        out = np.full((len(found), k.COLUMNS), np.nan)
        if not len(found):
            return out
        site = int(self.links.site[link])
        geometry = found.geometry.copy()
        geometry[:, 0] += self.sync_m[site] - self.offsets_m[site]
        path = _sources(geometry, truth, self.receiver.finer)
        std = np.sqrt(np.einsum("nii->ni", found.covariance) + self.floors**2)
        out[:, k.SNAPSHOT], out[:, k.LINK] = snapshot, link
        out[:, k.DISTANCE] = geometry[:, 0] + self.offsets_m[site]
        out[:, k.AZIMUTH], out[:, k.ELEVATION] = geometry[:, 1], geometry[:, 2]
        out[:, k.SNR_DB], out[:, k.CLAIMED_STD : k.CLAIMED_STD + 3] = found.snr_db, std
        real = path >= 0
        out[real, k.TRUE_STD : k.TRUE_STD + 3] = std[real]
        out[:, k.PATH] = np.where(real, path + first, -1)
        return out


def signal_level(
    config: RadioConfig, cells: Cells, offsets_m: Floats, fields: Fields, rng: np.random.Generator
) -> SignalLevel:
    """Draw a trial's receiver array and surroundings; clock `offsets_m` (S,) of the sites in m.

    Raises InputError where the cells, or keys of the configuration, do not suit the front end.
    """
    if (cells.ports > 2).any():
        raise InputError(
            "the signal-level front end receives antenna ports 0 and 1, but a site has more: set its ports to 1 or 2"
        )
    if config.noise_scale != 1.0 or config.perfect_detection or config.detection_scale != 1.0:
        raise InputError(
            "radio.noise_scale, perfect_detection and detection_scale belong to the statistical front end: leave them "
            "at 1, false and 1"
        )
    waveform = config.waveform()
    receiver = receiver_of(
        waveform, config.carrier_hz, threshold=config.detection_threshold, window_min_m=config.window_min_m,
        window_max_m=config.window_max_m, ghost_rule_db=config.ghost_rule_db,
    )  # fmt: skip
    array_rng = rng if config.array_seed is None else stream(config.array_seed, 1, Stream.ARRAY)
    array = miscalibrated(array_at(config.carrier_hz), PHASE_STD_DEG, GAIN_STD_DB, array_rng)
    # Calibration errors come from the array, diffuse ones from the scatterers: only the rest is drawn as such.
    angles = fields.direction_std * np.array([1.0, 0.0, 0.0, 1.0, 1.0])
    remaining = fields._replace(direction_std=angles, place_std=np.zeros(3))
    # A finer resolution needs more scatterers: as many in a cell as in LTE's.
    scatterers = round(SCATTERERS / receiver.finer)
    surroundings = Surroundings(int(rng.integers(2**32)), config.specular_to_diffuse_db, scatterers)
    carrier = CARRIER_OFFSET_STD_HZ * rng.standard_normal(len(offsets_m))
    return SignalLevel(config, waveform, cells, offsets_m, carrier, remaining, surroundings, array, receiver)


def true_geometry(paths: PathColumns, pose: Floats) -> Floats:
    """Return distance, azimuth and elevation (P, 3), m, rad, rad, of the traced paths at a pose (6,)."""
    towards = world_to_body(pose, paths.vt_m - pose[:3])
    return np.column_stack([np.linalg.norm(towards, axis=1), *azimuth_elevation(towards)])


def _sources(found: Floats, truth: Floats, finer: float) -> Ints:
    """Return which true path (n,) each estimate comes from, -1 none: least sum of squares, each path once. `finer`: by
    what the resolution in distance is finer than LTE's.
    """
    out = np.full(len(found), -1, np.int64)
    apart = found[:, None] - truth[None]
    apart[..., 1] = wrap_angle(apart[..., 1])
    cost = np.sum((apart / (SAME_PATH * [finer, 1.0, 1.0])) ** 2, axis=-1)
    for i, j in zip(*linear_sum_assignment(np.minimum(cost, 1.0)), strict=True):
        if cost[i, j] < 1.0:
            out[i] = j
    return out
