"""The paper's FastSLAM without this project's corrections of association, clutter and clock offsets."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from cellslam.sim.frames import integrate_pose, rotation
from cellslam.sim.recording import Floats, Ints
from cellslam.slam import warm_up
from cellslam.slam.api import Estimate, Setup, Snapshot, VtEstimate
from cellslam.slam.front_end.front_end_options import FrontEndOptions
from cellslam.slam.front_end.measurement_noise import first_of_link, white
from cellslam.slam.model.pose_moments import pose_moments
from cellslam.slam.model.resampling import systematic


class PaperFastSlamOptions(BaseModel):
    """What a scenario may set under `estimator.paper-fastslam`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    particles: int = Field(100, ge=1, le=100_000, description="number of particles")
    gate: float = Field(16.3, gt=0, le=1000, description="squared Mahalanobis distance beyond which a VT is born")
    vts_per_link: int = Field(24, ge=1, le=1000, description="VTs kept per link; the longest unseen makes room")
    effective_share: float = Field(
        0.5, ge=0, le=1, description="resample when the effective sample size falls below this share of the particles"
    )


class PaperFastSlam:
    """FastSLAM 1.0 with maximum-likelihood association by bare Mahalanobis distances, as the paper has it.

    Source: Chen, Whiton and Tufvesson, "Extended FastSLAM using cellular multipath component delays and angular
    information", sections III and IV, with its misprints put right (elevation, H Sigma H^T, Q / SNR) and nothing else:
    every measurement outside the gate becomes a VT, there is neither clutter nor missed detection, log det S is left
    out of the association. The clock offset is taken as the mean of its prior: given where that has no deviation,
    ignored otherwise.
    """

    name: ClassVar[str] = "paper-fastslam"
    requires_truth: ClassVar[bool] = False
    Options: ClassVar[type[PaperFastSlamOptions]] = PaperFastSlamOptions

    def __init__(self, options: PaperFastSlamOptions | None = None) -> None:
        self.options = options or PaperFastSlamOptions()
        self._front_end = FrontEndOptions()

    def warm_up(self) -> None:
        """Compile the kernel on a drive of four snapshots."""
        warm_up.drive(type(self)(self.options.model_copy(update={"particles": 2, "vts_per_link": 2})))

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Draw poses and odometry errors."""
        count, links, places = self.options.particles, len(setup.links), self.options.vts_per_link
        self._model, self._rng = setup.odometry_model, rng
        self._offset_of = np.array(setup.sites.clock_offset_mean_m[setup.links.site], np.float64)
        self._pose = setup.start_pose + setup.start_std * rng.standard_normal((count, 6))
        self._bias = self._model.bias * rng.standard_normal((count, 6))
        self._scale = self._model.scale * rng.standard_normal((count, 6))
        self._means, self._covs = np.zeros((count, links, places, 3)), np.zeros((count, links, places, 3, 3))
        self._slots = np.zeros((count, links, places, 2), np.int64)
        self._counts, self._log_weight = np.zeros((count, links), np.int64), np.zeros(count)
        self._now = self._born = 0

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Sample the motion, associate, update, weigh, resample.

        dt_s in s; odometry (6,): mean body velocities in m/s and rad/s.
        """
        if dt_s > 0.0:
            self._move(dt_s, odometry)
        association = self._use(snapshot)
        weight = np.exp(self._log_weight - self._log_weight.max())
        weight /= weight.sum()
        best = int(np.argmax(weight))
        answer = self._answer(weight, best, association[best].copy())
        if 1.0 / np.sum(weight**2) < self.options.effective_share * len(weight):
            self._resample(weight)
        self._now += 1
        self._born += len(snapshot)
        return answer

    def _move(self, dt_s: float, odometry: Floats) -> None:
        model, noise = self._model, self._rng.standard_normal((2, *self._pose.shape))
        self._bias = self._bias + model.bias_walk_density * np.sqrt(dt_s) * noise[0]
        velocity = (odometry - self._bias - model.noise_density / np.sqrt(dt_s) * noise[1]) / (1.0 + self._scale)
        self._pose = integrate_pose(self._pose, velocity, dt_s)

    def _use(self, snapshot: Snapshot) -> Ints:
        from cellslam.slam.fastslam.paper.paper_fastslam_kernel import Maps, Measured, Scratch, use_snapshot

        z = np.stack([snapshot.distance_m, snapshot.azimuth_rad, snapshot.elevation_rad], axis=1)
        q = white(snapshot, self._front_end) + np.sum(self._front_end.persisting, axis=0)
        whole = np.isfinite(z).all(axis=1)
        first = np.concatenate([[0], np.cumsum(whole)])[first_of_link(snapshot, len(self._offset_of))]
        given = Measured(z[whole], q[whole], first, self._offset_of)
        count, places, measured = len(self._pose), self.options.vts_per_link, len(given.z)
        wide, some = 4 * (measured + places + 4), np.full((count, measured), -1, np.int64)
        scratch = Scratch(
            np.empty((count, places, measured + 1)), np.empty((count, wide)),
            np.empty((count, measured + places + 2 + wide), np.int64),
        )  # fmt: skip
        use_snapshot(
            self._now, self._pose, rotation(self._pose[:, 3], self._pose[:, 4], self._pose[:, 5]),
            Maps(self._means, self._covs, self._slots, self._counts), given, self._born, self.options.gate,
            self._log_weight, some, scratch,
        )  # fmt: skip
        association = np.full((count, len(snapshot)), -1, np.int64)
        association[:, whole] = some
        return association

    def _answer(self, weight: Floats, best: int, association: Ints) -> Estimate:
        mean, covariance = pose_moments(self._pose, weight, self._pose[best])
        link, place = np.nonzero(np.arange(self.options.vts_per_link) < self._counts[best][:, None])
        vts = VtEstimate(
            self._slots[best, link, place, 1], link.astype(np.int64), self._means[best, link, place],
            self._covs[best, link, place],
        )  # fmt: skip
        return Estimate(mean, covariance, association, vts=vts)

    def _resample(self, weight: Floats) -> None:
        """Systematic resampling; maps are copied."""
        chosen = systematic(weight, len(weight), self._rng)
        for name in ("_pose", "_bias", "_scale", "_means", "_covs", "_slots", "_counts"):
            setattr(self, name, getattr(self, name)[chosen])
        self._log_weight[:] = 0.0
