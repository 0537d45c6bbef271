"""The world of a trial, drawn from its configuration and seed, and what its receiver measures at a pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from cellslam.sim.city import build_city
from cellslam.sim.city.city_config import CityConfig, MeshCityConfig, ProceduralCityConfig
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte.faults import ClockErrors, Reports, draw_clock_errors, draw_reports, poses_before
from cellslam.sim.lte.links import Cells, cells_of, links_of
from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.lte.sites import SiteConfig, place_sites
from cellslam.sim.lte.statistical.detector_layout import PathColumns, Streams
from cellslam.sim.progress import Progress, silent
from cellslam.sim.randomness import Stream, stream
from cellslam.sim.recording import Floats, Ints
from cellslam.sim.traffic import Blocked, Traffic, blocked_paths, draw_traffic, reflected_paths
from cellslam.sim.traffic.traffic_config import TrafficConfig
from cellslam.sim.vehicle import Drive, Odometry, drive, measure_odometry, plan_route, with_faults
from cellslam.sim.vehicle.route import Route
from cellslam.sim.vehicle.vehicle_config import OdometryConfig, VehicleConfig

if TYPE_CHECKING:
    from cellslam.sim.lte.signal.signal_front_end import SignalLevel
    from cellslam.sim.lte.statistical.measurement_kernel import Fields
    from cellslam.sim.lte.statistical.statistical_front_end import Detections
    from cellslam.sim.rays import Paths, Scene
    from cellslam.sim.rays.scattering import Scatterers

KEPT_SCENES = 2


class WorldConfig(BaseModel):
    """Everything that decides what is true and what is measured; each part's model stands beside its code."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    city: CityConfig = Field(description="the buildings")
    sites: tuple[SiteConfig, ...] = Field(min_length=1, description="base-station sites and their cells")
    vehicle: VehicleConfig = Field(default_factory=VehicleConfig, description="route and motion")
    odometry: OdometryConfig = Field(default_factory=OdometryConfig, description="errors of wheels and gyro")
    traffic: TrafficConfig = Field(default_factory=TrafficConfig, description="other vehicles, which block paths")
    radio: RadioConfig = Field(default_factory=RadioConfig, description="what is sent, and the receiver")


@dataclass(frozen=True)
class Reception:
    """One trial's drive, sites and receiver, without the world that the paths come from. `sites_m` (S, 3), `surveyed_m`
    (S, 3): where a survey has those that are known, NaN the others; `offsets_m` (S,) are the true clock offsets at the
    first snapshot, `drift_m_s` (S,) their rates, `clock_errors` what else they do; `fields` the receiver's errors that
    persist; `signals` is what radio.front_end = "signal" measures with.
    """

    config: WorldConfig
    seed: int
    trial: int
    sites_m: Floats
    surveyed_m: Floats
    cells: Cells
    drive: Drive
    offsets_m: Floats
    drift_m_s: Floats
    clock_errors: ClockErrors | None
    start_pose: Floats
    fields: Fields
    signals: SignalLevel | None

    def streams(self) -> Streams:
        """Return the receiver's generators at the start of the trial."""
        return Streams(*(self._rng(name) for name in (Stream.NOISE, Stream.DETECTION, Stream.CLUTTER)))

    def odometry(self) -> Odometry:
        """Return what wheels and gyro measure of the trial's drive, faults included."""
        measured = measure_odometry(self.drive, self.config.odometry, self._rng(Stream.ODOMETRY))
        return with_faults(measured, self.drive.time_s, self.config.odometry, self._rng(Stream.SENSORS))

    def reports(self) -> Reports | None:
        """Return when the receiver reports the snapshots of the trial's drive; None: each in time."""
        return draw_reports(self.config.radio, len(self.drive.time_s), self._rng(Stream.REPORTS))

    def _rng(self, name: Stream) -> np.random.Generator:
        return stream(self.seed, self.trial, name)

    def detect(
        self, paths: Paths, poses: Floats, velocities: Floats, odometry: Floats, rng: Streams, snapshot: int = 0,
        progress: Progress = silent, key: str = "",
    ) -> Detections:  # fmt: skip
        """Return what the receiver reports of `paths`, at `poses` (T, 6) in m and rad numbered from `snapshot`, at true
        and measured body velocities (T, 6) in m/s and rad/s. `key`: all that decides them, to keep what is finished.
        """
        columns, radio = path_columns(paths, len(poses), len(self.sites_m)), self.config.radio
        if self.signals is not None:
            from cellslam.sim.lte.signal.drive_in_blocks import detect_signals

            found = detect_signals(
                self.signals, columns, poses, velocities, odometry, rng.noise, snapshot, key, progress
            )
        else:
            from cellslam.sim.lte.statistical.statistical_front_end import detect

            found = detect(radio, self.cells, columns, poses, self.offsets_m, self.fields, rng, snapshot, progress)
        return self._drifted(found)

    def _drifted(self, found: Detections) -> Detections:
        """Return detections with what the sites' clocks have drifted since the first snapshot: the receiver's window
        follows."""
        if not self.drift_m_s.any() and self.clock_errors is None:
            return found
        m = found.measurements
        elapsed_s, site = m.snapshot * self.config.vehicle.snapshot_interval_s, links_of(self.cells).site[m.link]
        drifted = m.distance_m + self.drift_m_s[site] * elapsed_s
        if self.clock_errors is not None:
            wander_m = self.clock_errors.wander_m
            drifted += wander_m[np.minimum(m.snapshot, len(wander_m) - 1), site]
        return replace(found, measurements=replace(m, distance_m=drifted))


@dataclass(frozen=True)
class World(Reception):
    """One trial's world, ready to be measured. `traffic`: other vehicles, `scatterers`: points that scatter; None
    without any."""

    scene: Scene
    traffic: Traffic | None
    scatterers: Scatterers | None

    def trace(self, poses: Floats, snapshots: Ints | Floats, progress: Progress = silent) -> tuple[Paths, Blocked]:
        """Return the paths from every site to every one of `poses` (T, 6), in m and rad, and which of them vehicles
        block, being where they are at `snapshots` (T,), which may lie between two."""
        from cellslam.sim.rays import trace
        from cellslam.sim.rays.paths import joined
        from cellslam.sim.rays.scattering import scattered_paths

        city, carrier = self.config.city, self.config.radio.carrier_hz
        receivers_m = np.ascontiguousarray(poses[:, :3])
        paths = trace(
            self.scene,
            self.sites_m,
            receivers_m,
            city.max_order,
            carrier_hz=carrier,
            ground_reflection=city.ground_reflection,
            diffraction=city.diffraction,
            progress=progress,
        )
        if self.scatterers is not None:
            more = scattered_paths(self.scatterers, self.scene, self.sites_m, receivers_m, carrier)
            paths = joined([paths, *more])
        time_s = np.asarray(snapshots, np.float64) * self.config.vehicle.snapshot_interval_s
        if self.traffic is not None and self.config.traffic.reflect:
            more = reflected_paths(self.traffic, self.scene, self.sites_m, receivers_m, time_s, carrier)
            paths = joined([paths, *more])
        factor = self.config.radio.path_gain_factor(paths.length_m, paths.order)
        if factor is not None:
            paths = replace(paths, gain=paths.gain * factor[:, None, None])
        return paths, blocked_paths(self.traffic, paths, self.sites_m, receivers_m, time_s)

    def free_paths(self, poses: Floats, snapshots: Ints) -> Paths:
        """Return the paths to `poses` (T, 6), in m and rad, at `snapshots` (T,), less those that vehicles block."""
        paths, blocked = self.trace(poses, snapshots)
        return paths.take(blocked.free(len(paths)))

    def measure(
        self, poses: Floats, velocities: Floats, snapshot: int, rng: Streams, odometry: Floats | None = None
    ) -> tuple[Detections, Paths]:
        """Return what the receiver reports at `poses` (n, 6), numbered from `snapshot`, and the paths that exist there.

        `velocities` (n, 6) are the true body velocities during the snapshots, `odometry` (n, 6) what the receiver knows
        of them (None: the truth). `rng` advances: calls along a drive, in order and with the same streams, give the
        drive's recording. `Detections.path` indexes the returned paths.
        """
        known = velocities if odometry is None else odometry
        paths = self.free_paths(poses, snapshot + np.arange(len(poses)))
        return self.detect(paths, poses, velocities, known, rng, snapshot), paths

    def measured_at(self, late_s: Floats | None = None) -> tuple[Floats, Floats]:
        """Return where the snapshots of the trial's drive are measured (T, 6), and when (T,), counted in snapshots.

        `late_s` (T,): how long before its snapshot each is (None: in time).
        """
        moment = np.arange(len(self.drive.poses), dtype=np.float64)
        if late_s is None:
            return self.drive.poses, moment
        earlier = np.maximum(moment - late_s / self.config.vehicle.snapshot_interval_s, 0.0)
        return poses_before(self.drive.poses, self.drive.time_s, late_s), earlier

    def measure_drive(
        self, rng: Streams, progress: Progress = silent, odometry: Floats | None = None, late_s: Floats | None = None
    ) -> tuple[Detections, Paths, Blocked]:
        """Return all detections of the trial's drive, its paths, receiver t being snapshot t, and which are blocked.

        `odometry` (T, 6): measured body velocities, with which the receiver undoes Doppler (None: the truth);
        `late_s` (T,): how long before its snapshot each was measured (None: in time).
        """
        poses, moment = self.measured_at(late_s)
        paths, blocked = self.trace(poses, moment, progress)
        velocities = self.drive.velocity
        known = velocities if odometry is None else odometry
        key = f"{self.config.model_dump_json()} {self.seed} {self.trial}"
        free = np.flatnonzero(blocked.free(len(paths)))
        found = self.detect(paths.take(free), poses, velocities, known, rng, 0, progress, key)
        return replace(found, path=np.append(free, -1)[found.path]), paths, blocked


def prepare(config: WorldConfig, seed: int, trial: int, progress: Progress = silent, place: int | None = None) -> World:
    """Draw the world of one trial: city, route, sites, drive, traffic and clock offsets. `place`: trial whose city,
    route and sites it has (None: its own). Raises InputError where they do not fit.
    """
    from cellslam.sim.rays.scattering import draw_scatterers

    with progress("preparing the world", 5) as advance:
        where = trial if place is None else place
        scene, route = city_and_route(config, seed, where)
        advance(2)
        sites_m = place_sites(scene.city, route, config.sites, stream(seed, where, Stream.SITES))
        advance(1)
        driven = drive(route, config.vehicle, stream(seed, trial, Stream.VEHICLE))
        advance(1)
        rng = stream(seed, trial, Stream.TRAFFIC)
        traffic = draw_traffic(config.traffic, scene.city, route, driven, config.vehicle, rng)
        advance(1)
    scatterers = None
    if config.radio.scatterers > 0.0:
        rng = stream(*_city_root(config, seed, where), Stream.SCATTERERS)
        scatterers = draw_scatterers(scene, config.radio.scatterers, rng)
    reception = draw_reception(config, seed, trial, sites_m, driven, place)
    return World(**vars(reception), scene=scene, traffic=traffic, scatterers=scatterers)


def city_and_route(config: WorldConfig, seed: int, trial: int) -> tuple[Scene, Route]:
    """Return the city of a trial, prepared for tracing, and the route through it. Raises InputError."""
    scene = _scene(config.city.model_dump_json(), *_city_root(config, seed, trial))
    return scene, plan_route(scene.city, config.vehicle, stream(seed, trial, Stream.ROUTE))


def draw_reception(
    config: WorldConfig, seed: int, trial: int, sites_m: Floats, driven: Drive, place: int | None = None
) -> Reception:
    """Draw survey, clock offsets, start and receiver of a trial with sites (S, 3) in m. `place`: trial whose survey it
    has (None: its own). Raises InputError where they do not fit.
    """
    from cellslam.sim.lte.persisting_errors import draw_fields

    cells = cells_of(config.sites)
    sent = links_of(cells)
    config.radio.waveform().combs(list(zip(sent.cell_id.tolist(), sent.port.tolist(), strict=True)))  # or InputError
    rng = stream(seed, trial, Stream.OFFSETS)
    offsets_m = config.radio.clock_offset_std_m * rng.standard_normal(len(config.sites))
    start = driven.poses[0] + np.array(config.vehicle.start_std) * rng.standard_normal(6)
    drift_m_s = SPEED_OF_LIGHT_MPS * config.radio.clock_drift * rng.standard_normal(len(config.sites))
    receiver_rng, clocks_rng = stream(seed, trial, Stream.RECEIVER), stream(seed, trial, Stream.CLOCKS)
    survey_rng = stream(seed, trial if place is None else place, Stream.SURVEY)
    survey_std_m = np.array([site.survey_std_m if site.known else np.nan for site in config.sites])
    surveyed_m = sites_m + survey_std_m[:, None] * survey_rng.standard_normal(sites_m.shape)
    clock_errors = draw_clock_errors(config.radio, driven.time_s - driven.time_s[0], len(config.sites), clocks_rng)
    fields = draw_fields(config.radio, config.vehicle.snapshot_interval_s, receiver_rng)
    signals = None
    if config.radio.front_end == "signal":
        from cellslam.sim.lte.signal.signal_front_end import signal_level

        signals = signal_level(config.radio, cells, offsets_m, fields, receiver_rng)
    clocks = offsets_m, drift_m_s, clock_errors
    return Reception(config, seed, trial, sites_m, surveyed_m, cells, driven, *clocks, start, fields, signals)


def path_columns(paths: Paths, receivers: int, sites: int) -> PathColumns:
    """Return the columns of traced paths that the front ends read; paths are sorted by receiver, then site."""
    key = paths.receiver * sites + paths.transmitter
    rows = np.searchsorted(key, np.arange(receivers * sites + 1)).astype(np.int64)
    departure = np.stack([paths.departure_azimuth_rad, paths.departure_elevation_rad], axis=1)
    return PathColumns(rows, np.ascontiguousarray(paths.vt_position_m), np.ascontiguousarray(paths.gain), departure)


def city_rng(config: WorldConfig, seed: int, trial: int) -> np.random.Generator:
    """Return the generator that draws the city: of its own seed, or of the trial where `city.seed` is "trial"."""
    return stream(*_city_root(config, seed, trial), Stream.CITY)


def _city_root(config: WorldConfig, seed: int, trial: int) -> tuple[int, int]:
    own = getattr(config.city, "seed", 0)
    return (seed, trial) if own == "trial" else (int(own), 0)


@lru_cache(maxsize=KEPT_SCENES)
def _scene(city_json: str, seed: int, trial: int) -> Scene:
    """Return the city of a configuration, prepared for tracing; the last few are kept, as a preset's city is every
    trial's."""
    from cellslam.sim.rays import prepare as prepare_scene

    city: ProceduralCityConfig | MeshCityConfig = TypeAdapter(CityConfig).validate_json(city_json)
    return prepare_scene(build_city(city, stream(seed, trial, Stream.CITY)))
