"""A drive through Stone Soup's extended Kalman filter and particle filter, the VTs and associations being known.

With this file in the current directory, and Stone Soup installed (pip install stonesoup):
cellslam run tiny --set radio.clock_offset_std_m=0 --estimator with_stone_soup:Ekf --estimator with_stone_soup:Particles
"""

from datetime import datetime, timedelta

import numpy as np
from stonesoup.base import Property
from stonesoup.models.base import GaussianModel, TimeVariantModel
from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
from stonesoup.models.transition import TransitionModel
from stonesoup.predictor.kalman import ExtendedKalmanPredictor
from stonesoup.predictor.particle import ParticlePredictor
from stonesoup.resampler.particle import SystematicResampler
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState, ParticleState
from stonesoup.updater.kalman import ExtendedKalmanUpdater
from stonesoup.updater.particle import ParticleUpdater

from cellslam.slam.api import Estimate

BEGIN = datetime(2026, 1, 1)


class Odometry(GaussianModel, TimeVariantModel, TransitionModel):
    """State (x, y, yaw, bias of the gyro, scale of the wheels) in m and rad, moved by what wheels and gyro measure."""

    velocity = Property(np.ndarray, doc="body velocities (6,) of the interval")
    density = Property(np.ndarray, doc="deviation of forward and yaw noise, per square root of a second")

    @property
    def ndim_state(self):
        return 5

    def function(self, state, noise=False, time_interval=None, **kwargs):
        dt = time_interval.total_seconds()
        x, y, yaw, bias, scale = np.asarray(state.state_vector, float)
        ahead, turn = self.velocity[0] / (1.0 + scale) * dt, (self.velocity[3] - bias) * dt
        if noise is not False and noise is not None:
            ahead = ahead + self.density[0] * np.sqrt(dt) * np.random.standard_normal(x.shape)
            turn = turn + self.density[1] * np.sqrt(dt) * np.random.standard_normal(x.shape)
        middle = yaw + 0.5 * turn
        moved = [x + ahead * np.cos(middle), y + ahead * np.sin(middle), yaw + turn, bias, scale]
        return type(state.state_vector)(moved)

    def covar(self, time_interval=None, prior=None, **kwargs):
        variance = self.density**2 * time_interval.total_seconds()
        return np.diag([variance[0], variance[0], variance[1], 0.0, 0.0])


class Paths(NonLinearGaussianMeasurement):
    """Lengths and azimuths (2m,) of m paths, in m and rad: distances to VTs, and their directions off the heading."""

    vts = Property(np.ndarray, doc="positions (m, 3) in m")
    height_m = Property(float, doc="of the array")

    @property
    def ndim_meas(self):
        return 2 * len(self.vts)

    def function(self, state, noise=False, **kwargs):
        x, y, yaw = np.asarray(state.state_vector, float)[:3, None, :]
        east, north = self.vts[:, 0, None] - x, self.vts[:, 1, None] - y
        length = np.sqrt(east**2 + north**2 + (self.vts[:, 2, None] - self.height_m) ** 2)
        kind = StateVector if state.state_vector.shape[1] == 1 else StateVectors
        return kind(np.concatenate([length, np.arctan2(north, east) - yaw]))

    def rvs(self, *args, **kwargs):
        raise NotImplementedError

    def logpdf(self, state1, state2, **kwargs):
        off = np.asarray(state1.state_vector, float) - np.asarray(self.function(state2), float)
        return -0.5 * (off**2 / np.diag(self.noise_covar)[:, None]).sum(axis=0)


class Ekf:
    """Stone Soup's extended Kalman filter as an estimator of cellslam."""

    name = "stone-soup-ekf"
    requires_truth = True

    def __init__(self, options=None):
        self.time = BEGIN

    def start(self, setup, rng):
        self.truth, self.pose = setup.truth, np.array(setup.start_pose)
        np.random.seed(int(rng.integers(2**31)))
        model = setup.odometry_model
        self.motion = Odometry(np.zeros(6), model.noise_density[[0, 3]])
        start = [*self.pose[[0, 1, 3]], 0.0, 0.0]
        self.begin(start, np.diag([1e-6, 1e-6, 1e-8, model.bias[3] ** 2, model.scale[0] ** 2]))

    def begin(self, mean, covariance):
        self.predictor = ExtendedKalmanPredictor(self.motion)
        self.updater = ExtendedKalmanUpdater(None)
        self.belief = GaussianState(StateVector(mean), covariance, timestamp=self.time)

    def step(self, dt_s, odometry, snapshot):
        self.time += timedelta(seconds=dt_s)
        if dt_s > 0.0:
            self.motion.velocity = odometry
            self.belief = self.predictor.predict(self.belief, timestamp=self.time)
        vt = self.truth.measurement_vt[snapshot.row]
        real = vt >= 0
        if real.any():
            std = np.concatenate([snapshot.distance_std_m[real], snapshot.azimuth_std_rad[real]])
            paths = Paths(ndim_state=5, mapping=(0, 1, 2), noise_covar=np.diag(std**2), vts=self.truth.vts.position_m[vt[real]], height_m=self.pose[2])
            measured = np.concatenate([snapshot.distance_m[real], snapshot.azimuth_rad[real]])
            expected = np.asarray(paths.function(GaussianState(self.belief.mean, np.eye(5))), float)[:, 0]
            turns = np.round((expected - measured) / (2.0 * np.pi)) * np.repeat([0.0, 1.0], real.sum())
            detection = Detection(
                StateVector(measured + 2.0 * np.pi * turns), timestamp=self.time, measurement_model=paths
            )
            self.belief = self.updater.update(SingleHypothesis(self.belief, detection))
        return self.answer()

    def answer(self):
        mean = np.asarray(self.belief.mean, float).ravel()[:3]
        covariance = np.asarray(self.belief.covar, float)[:3, :3]
        self.pose[[0, 1, 3]] = mean
        whole = np.zeros((6, 6))
        whole[np.ix_([0, 1, 3], [0, 1, 3])] = covariance
        return Estimate(self.pose.copy(), whole)


class Particles(Ekf):
    """Stone Soup's bootstrap particle filter with 500 particles."""

    name = "stone-soup-particles"

    def begin(self, mean, covariance):
        self.predictor = ParticlePredictor(self.motion)
        self.updater = ParticleUpdater(None, resampler=SystematicResampler())
        drawn = np.random.multivariate_normal(mean, covariance, 500).T
        self.belief = ParticleState(StateVectors(drawn), weight=np.full(500, 1 / 500), timestamp=self.time)
