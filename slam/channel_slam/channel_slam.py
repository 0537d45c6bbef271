"""Channel-SLAM: positioning by the delays of multipath components alone."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from cellslam.sim.frames import integrate_pose
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Estimate, Setup, Snapshot, VtEstimate
from cellslam.slam.channel_slam.channel_slam_kernel import COMPONENT, DIAGONAL, MEAN, describe, face, weigh
from cellslam.slam.channel_slam.channel_slam_options import ChannelSlamOptions
from cellslam.slam.channel_slam.delay_tracks import Tracks
from cellslam.slam.model.pose_moments import pose_moments
from cellslam.slam.model.resampling import systematic

OFFSETS, OFFSET_WEIGHTS, OFFSET_WIDTH = (-1.25, 0.0, 1.25), (0.27, 0.46, 0.27), 0.72  # a normal density as three


class ChannelSlam:
    """Rao-Blackwellised particle filter: user particles, and in each a filter of its own for every transmitter.

    Source: Gentner, Jost, Wang, Zhang, Dammann and Fiebig, "Multipath assisted positioning with simultaneous
    localization and mapping", IEEE Trans. Wireless Communications 15, 2016. Every tracked path has a transmitter at an
    unknown place with a clock offset of its own; angles are not used. Here in space instead of the plane, and with a
    mixture of Gaussians in the place of each transmitter's particles, whose sampling noise would outweigh the evidence.
    """

    name: ClassVar[str] = "channel-slam"
    requires_truth: ClassVar[bool] = False
    Options: ClassVar[type[ChannelSlamOptions]] = ChannelSlamOptions

    def __init__(self, options: ChannelSlamOptions | None = None) -> None:
        self.options = options or ChannelSlamOptions()

    def warm_up(self) -> None:
        """Compile the kernels on one particle with two transmitters."""
        mixture, counts = np.ones((1, 2, 1, COMPONENT)), np.ones((1, 2), np.int64)
        place, _ = np.nonzero(np.ones((2, 1)))  # laid out as in a drive
        weigh(
            np.zeros((1, 6)), np.zeros((1, 2, 3)), mixture, counts, place, np.ones(2), np.ones(2), 1.0, 0.0, np.zeros(1)
        )  # fmt: skip
        describe(np.zeros(3), mixture[0, 0], 1, np.zeros((4, 8)), np.zeros((5, 4)))

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Draw poses and odometry errors."""
        o, model = self.options, setup.odometry_model
        self._setup, self._rng, self._time_s, self._born, self._way_m = setup, rng, 0.0, 0, np.inf
        self._pose = setup.start_pose + setup.start_std * rng.standard_normal((o.particles, 6))
        self._bias = model.bias * rng.standard_normal((o.particles, 6))
        self._scale = model.scale * rng.standard_normal((o.particles, 6))
        self._log_weight = np.zeros(o.particles)
        self._tracks = Tracks.none()
        self._mixture = np.zeros((o.particles, o.transmitters, len(OFFSETS) * o.directions, COMPONENT))
        self._counts = np.zeros((o.particles, o.transmitters), np.int64)
        self._anchor = np.zeros((o.particles, o.transmitters, 3))
        self._holder = np.full(o.transmitters, -1, np.int64)  # identity of the track that has each place
        self._link = np.zeros(o.transmitters, np.int64)
        self._archive: list[tuple[int, int, Floats, Floats]] = []
        self._found: dict[int, list[tuple[int, int, Floats, Floats]]] = {}  # by particle, until anything changes

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Move, follow the paths, and every `update_m` weigh, resample, and begin transmitters.

        dt_s in s; odometry (6,): mean body velocities in m/s and rad/s.
        """
        o = self.options
        self._time_s += dt_s
        if dt_s > 0.0:
            self._move(dt_s, odometry)
        association = self._tracks.follow(snapshot, self._time_s, dt_s, o.track_gate_m, o.track_gap_s, self._born)
        self._born += len(snapshot)
        self._end()
        self._way_m += abs(float(odometry[0])) * dt_s
        if self._way_m >= o.update_m:
            self._way_m = 0.0
            self._found.clear()
            self._use(association, snapshot)
            self._begin()
        weight = self._weights()
        best = int(np.argmax(weight))
        answer = self._answer(weight, best, association)
        if 1.0 / np.sum(weight**2) < o.effective_share * len(weight):
            self._resample(weight)
        return answer

    def _move(self, dt_s: float, odometry: Floats) -> None:
        model, noise = self._setup.odometry_model, self._rng.standard_normal((2, *self._pose.shape))
        self._bias = self._bias + model.bias_walk_density * np.sqrt(dt_s) * noise[0]
        velocity = (odometry - self._bias - model.noise_density / np.sqrt(dt_s) * noise[1]) / (1.0 + self._scale)
        self._pose = integrate_pose(self._pose, velocity, dt_s)

    def _use(self, association: Ints, snapshot: Snapshot) -> None:
        """Update the transmitters that were detected, and weigh."""
        o = self.options
        place, row = np.nonzero((self._holder[:, None] == association) & (self._holder[:, None] >= 0))
        if len(place) == 0:
            return
        distance, site = snapshot.distance_m[row], self._setup.links.site[snapshot.link[row]]
        # The links of a site that see one path see one error.
        shared = (np.abs(distance[:, None] - distance) < 3.0 * o.distance_std_m) & (site[:, None] == site)
        variance = o.distance_std_m**2 * shared.sum(axis=1)
        weigh(
            self._pose, self._anchor, self._mixture, self._counts, place, np.ascontiguousarray(distance), variance,
            o.outlier_density, o.drop_weight, self._log_weight,
        )  # fmt: skip

    def _begin(self) -> None:
        """Give a mixture to each track that has lasted, where there is a place: all that its distance allows."""
        t = self._tracks
        for j in np.flatnonzero((t.hits >= self.options.track_hits) & ~np.isin(t.id, self._holder)):
            free = np.flatnonzero(self._holder < 0)
            if len(free) == 0:
                return
            place = int(free[0])
            fresh = self._fresh(int(self._setup.links.site[t.link[j]]), float(t.distance_m[j]))
            self._counts[:, place] = len(fresh)
            self._mixture[:, place, : len(fresh)] = fresh
            self._anchor[:, place] = self._pose[:, :3]
            self._holder[place], self._link[place] = t.id[j], t.link[j]

    def _fresh(self, site: int, distance_m: float) -> Floats:
        """Return the components (M, 19) of a new transmitter: every azimuth, and the clock offset's prior."""
        o, sites = self.options, self._setup.sites
        prior = float(sites.clock_offset_std_m[site])
        spacing = 2.0 * np.pi / o.directions
        azimuth, number = np.meshgrid(spacing * np.arange(o.directions), np.arange(len(OFFSETS)))
        offset = sites.clock_offset_mean_m[site] + prior * np.array(OFFSETS)[number.ravel()]
        out = np.zeros((azimuth.size, COMPONENT))
        out[:, 0] = np.array(OFFSET_WEIGHTS)[number.ravel()] * (offset < distance_m - 10.0)
        if out[:, 0].sum() == 0.0:
            out[:, 0] = 1.0
        out[:, 0] /= out[:, 0].sum()
        out[:, MEAN], out[:, MEAN + 1], out[:, MEAN + 2] = distance_m, azimuth.ravel(), np.radians(o.elevation_deg)
        out[:, MEAN + 3] = np.minimum(offset, distance_m - 10.0)
        widths = (o.distance_std_m, 0.6 * spacing, np.radians(o.elevation_std_deg), max(OFFSET_WIDTH * prior, 1e-3))
        out[:, DIAGONAL] = np.square(widths)
        face(out)
        return out[out[:, 0] > 0.0]

    def _end(self) -> None:
        """Keep what is known of transmitters whose track has ended, and free their places."""
        over = np.flatnonzero((self._holder >= 0) & ~np.isin(self._holder, self._tracks.id))
        if len(over):
            best = int(np.argmax(self._log_weight))
            self._archive += self._described(best, over)
            self._holder[over] = -1
            self._found.clear()

    def _described(self, user: int, places: Ints) -> list[tuple[int, int, Floats, Floats]]:
        """Return identity, link, mean and covariance (x, y, z, offset) of transmitters that are certain enough."""
        out: list[tuple[int, int, Floats, Floats]] = []
        for place in places:
            found = np.empty((5, 4))
            count = int(self._counts[user, place])
            describe(self._anchor[user, place], self._mixture[user, place], count, np.empty((4, 8)), found)
            if np.sqrt(np.trace(found[1:4, :3])) <= self.options.map_std_m:
                cov = found[1:] + 1e-9 * np.eye(4)
                out.append((int(self._holder[place]), int(self._link[place]), found[0], cov))
        return out

    def _weights(self) -> Floats:
        weight = np.exp(self._log_weight - self._log_weight.max())
        return np.asarray(weight / weight.sum())

    def _answer(self, weight: Floats, best: int, association: Ints) -> Estimate:
        mean, covariance = pose_moments(self._pose, weight, self._pose[best])
        if best not in self._found:
            self._found[best] = self._described(best, np.flatnonzero(self._holder >= 0))
        known = [*self._archive, *self._found[best]]
        held = np.isin(association, self._holder)
        return Estimate(
            mean, covariance, np.where(held, association, -1), *self._offsets(known),
            _map(known),
        )  # fmt: skip

    def _offsets(self, known: list[tuple[int, int, Floats, Floats]]) -> tuple[Floats, Floats]:
        """Return the clock offset of each site (S,) and its variance: the median of its known transmitters."""
        sites = self._setup.sites
        mean, variance = sites.clock_offset_mean_m.copy(), sites.clock_offset_std_m**2
        site_of = np.array([self._setup.links.site[entry[1]] for entry in known], np.int64)
        for site in np.unique(site_of):
            own = [entry for entry, s in zip(known, site_of, strict=True) if s == site]
            mean[site] = np.median([entry[2][3] for entry in own])
            variance[site] = min(np.median([entry[3][3, 3] for entry in own]), variance[site])
        return mean, variance

    def _resample(self, weight: Floats) -> None:
        """Systematic resampling; transmitters are copied, odometry errors spread by a kernel (Liu and West, 2001)."""
        chosen = systematic(weight, len(weight), self._rng)
        for name in ("_pose", "_bias", "_scale", "_anchor", "_counts"):
            setattr(self, name, getattr(self, name)[chosen])
        for place in np.flatnonzero(self._holder >= 0):
            most = int(self._counts[:, place].max())
            self._mixture[:, place, :most] = self._mixture[chosen, place, :most]
        self._log_weight[:] = 0.0
        self._found.clear()
        width = self.options.kernel_width
        for errors in (self._bias, self._scale):
            mean, std = errors.mean(axis=0), errors.std(axis=0)
            errors += (np.sqrt(1.0 - width**2) - 1.0) * (errors - mean)
            errors += width * std * self._rng.standard_normal(errors.shape)


def _map(known: list[tuple[int, int, Floats, Floats]]) -> VtEstimate:
    """Return the transmitters as VTs."""
    ids, links = (np.array([entry[i] for entry in known], np.int64) for i in (0, 1))
    position = np.array([entry[2][:3] for entry in known]).reshape(-1, 3)
    return VtEstimate(ids, links, position, np.array([entry[3][:3, :3] for entry in known]).reshape(-1, 3, 3))
