"""Pitch and roll of a vehicle whose odometry does not see them: followed from one snapshot to the next.

Acceleration, turns and the road tilt the array by tenths of a degree for seconds. Twenty directions at once, most of
landmarks that are well known, tell by how much; what the next snapshot measures is then turned into the level frame.
The attitude is a first-order Gauss-Markov process; an error that all directions have in common is left out.

Source: Gelb, "Applied optimal estimation", 1974, chapters 3 (Gauss-Markov process) and 4 (Kalman filter, in information
form), with the azimuth and elevation of the paper, eq. 25 to 27.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TypeVar

import numpy as np

from cellslam.sim.frames import azimuth_elevation, rotation, unit_vector, wrap_angle
from cellslam.sim.recording import Floats
from cellslam.slam.api import Estimate, Setup, Snapshot
from cellslam.slam.measurements.measurement_options import MeasurementOptions
from cellslam.slam.measurements.misfit import rows_of

GATE = 4.0  # deviations beyond which a direction says nothing
FLATTEST = 0.1  # a VT higher above the array, flat part over range, says nothing
TINY = 1e-12

Seen = TypeVar("Seen", bound=Snapshot)


class Attitude:
    """Belief on pitch and roll: `mean` (2,) in rad, `covariance` (2, 2)."""

    def __init__(self, options: MeasurementOptions, setup: Setup) -> None:
        """Begin level. What the odometry or the start says of pitch and roll belongs to the pose: then this is off."""
        model = setup.odometry_model
        seen = np.concatenate([model.noise_density[4:], model.bias[4:], setup.start_std[4:], setup.start_pose[4:]])
        self.prior = np.radians([options.pitch_deg, options.roll_deg]) ** 2
        self.on = bool((self.prior > 0.0).all()) and not seen.any()
        self.options, self.mean, self.covariance = options, np.zeros(2), np.diag(self.prior)

    def levelled(self, dt_s: float, snapshot: Seen) -> Seen:
        """Return a snapshot's measurements as a level array would have made them, `dt_s` after the last ones."""
        if not self.on:
            return snapshot
        left = math.exp(-dt_s / self.options.attitude_scale_s)  # of what was known
        self.mean = left * self.mean
        self.covariance = left**2 * self.covariance + (1.0 - left**2) * np.diag(self.prior)
        measured = np.stack([snapshot.azimuth_rad, snapshot.elevation_rad])
        turned = azimuth_elevation(unit_vector(*measured) @ rotation(0.0, *self.mean).T)
        azimuth, elevation = np.where(np.isnan(measured).any(axis=0), measured, turned)
        return replace(snapshot, azimuth_rad=azimuth, elevation_rad=elevation)

    def concluded(self, answer: Estimate, snapshot: Snapshot, variance: Floats, pose: Floats | None = None) -> Estimate:
        """Learn from a snapshot's measurements as they were made, and return the answer to them with pitch and roll.

        `variance` (m, 3): those with which an update counts for what it is worth. `pose` (6,): from where the answer's
        VTs were seen, where that is not its pose.
        """
        if not self.on:
            return answer
        pose = answer.pose if pose is None else pose
        if len(snapshot) and answer.association is not None and answer.vts is not None and len(answer.vts.id):
            row = rows_of(answer.association, answer.vts.id)
            there = (row >= 0) & np.isfinite(snapshot.azimuth_rad) & np.isfinite(snapshot.elevation_rad)
            to_vt = answer.vts.position_m[row[there]] - pose[:3]
            z = np.stack([snapshot.azimuth_rad, snapshot.elevation_rad], axis=1)[there]
            yaw = rotation(pose[3], 0.0, 0.0)
            self._observe(yaw, to_vt, answer.vts.covariance[row[there]], z, variance[there, 1:])
        mean, covariance = answer.pose.copy(), answer.covariance.copy()
        mean[4:], covariance[4:, 4:] = self.mean, self.covariance
        return replace(answer, pose=mean, covariance=covariance)

    def _observe(self, yaw: Floats, to_vt: Floats, spread: Floats, z: Floats, variance: Floats) -> None:
        """Update by azimuths and elevations z (n, 2), in rad, with their variances (n, 2), of VTs that are at `to_vt`
        (n, 3) from the array in m, with covariances (n, 3, 3); yaw (3, 3) turns the array.

        The state is pitch, roll, and the errors of azimuth and elevation that all measurements have in common.
        """
        body, common = to_vt @ yaw @ rotation(0.0, *self.mean), self.options.persisting[0][1:]
        reach, flat = np.linalg.norm(body, axis=1), np.maximum(np.hypot(body[:, 0], body[:, 1]), TINY)
        (ca, sa, slope), zero, one = body.T / flat, np.zeros(len(flat)), np.ones(len(flat))
        error = wrap_angle(z - np.stack(azimuth_elevation(body), axis=1))
        by_state = np.array([[slope * sa, slope * ca, one, zero], [ca, -sa, zero, one]])
        by_place = np.array([[-sa, ca, zero], [-ca * body[:, 2] / reach, -sa * body[:, 2] / reach, flat / reach]])
        axis = np.einsum("ij,cjn->nci", yaw, by_place)  # along which the VT's place changes an angle, times its range
        loose = np.einsum("nci,nij,ncj->nc", axis, spread, axis)
        wide = variance + TINY + loose / np.maximum(np.stack([flat, reach], axis=1), 1.0) ** 2
        fits = error**2 <= GATE**2 * (wide + common + np.trace(self.covariance))
        fits &= (flat >= FLATTEST * reach)[:, None]
        weight = np.where(fits, 1.0 / wide, 0.0)
        information = np.diag([0.0, 0.0, *(1.0 / (common + TINY))])
        information[:2, :2] = np.linalg.inv(self.covariance)
        information += np.einsum("crn,csn,nc->rs", by_state, by_state, weight)
        covariance = np.linalg.inv(information)
        score = np.einsum("crn,nc,nc->r", by_state, error, weight)
        self.mean, self.covariance = self.mean + covariance[:2] @ score, covariance[:2, :2]
