# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # An estimator in a notebook
#
# The measurement that needs no map: where odometry says that the vehicle stands, it stands. This estimator integrates
# odometry, and takes a speed below a threshold for a stop.

# %%
import numpy as np

import cellslam
from cellslam.sim.frames import integrate_pose

# %% [markdown]
# The class. `odometry` is body velocities in m/s and rad/s since the last snapshot; the truth is nowhere to be seen.


# %%
class Stops:
    name = "stops"
    slowest_mps = 0.05

    def __init__(self, options):
        self.pose = None

    def start(self, setup, rng):
        self.pose = setup.start_pose
        self.variance_m2 = 0.0

    def step(self, dt_s, odometry, snapshot):
        if abs(odometry[0]) > self.slowest_mps:
            self.pose = integrate_pose(self.pose, odometry, dt_s)
            self.variance_m2 += (0.01 * odometry[0] * dt_s) ** 2
        return cellslam.Estimate(self.pose, np.diag([self.variance_m2 + 1e-4] * 3 + [1e-4] * 3))


# %% [markdown]
# Run it beside plain dead reckoning on the same three drives.

# %%
rows = cellslam.run("tiny", [Stops, "dead-reckoning"], trials=3)
rows.pivot(index="trial", columns="estimator", values="position_rmse_m").round(3)

# %% [markdown]
# Its covariance claims too little: a mean NEES of 2 would be right.

# %%
rows.groupby("estimator").nees_mean.median()
