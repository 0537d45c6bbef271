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
# # A drive in ten cells
#
# Simulate a drive, run two estimators, and look at truth, measurements and estimates.

# %%
import matplotlib.pyplot as plt
import numpy as np

import cellslam

# %% [markdown]
# One trial. It shows itself as the table of its rows. For the drive of the README write `"lund-530"`.

# %%
trial = cellslam.trial("tiny", ["ekf-slam", "dead-reckoning"])
trial

# %% [markdown]
# The figures of `cellslam run`, by name.

# %%
trial.plot("map")

# %%
trial.plot("error")

# %% [markdown]
# What was measured: one row a path.

# %%
measured = trial.recording.measurements
plt.figure(figsize=(7, 3))
seen = measured.link == 0
plt.plot(trial.recording.time_s[measured.snapshot[seen]], measured.distance_m[seen], ".", markersize=2)
plt.xlabel("time (s)")
plt.ylabel("distance, clock offset included (m)")

# %% [markdown]
# Truth and estimates are arrays: pose is x, y, z in m and yaw, pitch, roll in rad.

# %%
truth = trial.recording.truth.poses
for name, estimate in trial.estimates.items():
    error = np.hypot(*(estimate.poses - truth)[:, :2].T)
    print(f"{name}: {np.sqrt(np.mean(error**2)):.2f} m")

# %% [markdown]
# The virtual transmitters at the end, and the bound beside the claimed deviation.

# %%
vts = trial.estimates["ekf-slam"].vts
print(f"{len(vts.position_m)} virtual transmitters, {len(trial.recording.truth.vts)} in truth")
print(f"bound {trial.bound.position_rmse_m:.2f} m")

# %% [markdown]
# Several trials are a pandas table.

# %%
rows = cellslam.run("tiny", "dead-reckoning", trials=3, seed=1)
rows.groupby("estimator").position_rmse_m.describe()
