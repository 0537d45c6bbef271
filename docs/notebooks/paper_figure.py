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
# # A figure for a paper
#
# What is it worth to know the clocks of the base stations? The posterior Cramér-Rao bound says it for every filter at
# once: the least position error that any can have on average, against time.

# %%
import matplotlib.pyplot as plt

import cellslam
from cellslam.benchmarks.bound.cramer_rao import bound

# %% [markdown]
# Two minutes of `lund-530`, with a coarser time step so that it takes seconds. The same seed gives the same drive.

# %%
DRIVE = {"vehicle.distance_m": 120, "vehicle.duration_s": 120, "vehicle.stops": 1, "vehicle.snapshot_interval_s": 0.3}
CLOCKS_M = {"known": 0.0, "within 10 m": 10.0, "within 150 m": 150.0}

curves = {}
for label, deviation_m in CLOCKS_M.items():
    scenario = cellslam.load("lund-530", DRIVE | {"radio.clock_offset_std_m": deviation_m})
    recording = cellslam.simulate(scenario, seed=0)
    curves[label] = recording.elapsed_s, bound(recording).horizontal_std_m

# %% [markdown]
# A column wide, colours that the colour-blind tell apart, as PDF for the paper and PNG to look at.

# %%
plt.rcParams.update({"font.size": 8, "savefig.dpi": 160})
figure, axes = plt.subplots(figsize=(3.5, 2.4), layout="constrained")
for (label, (time_s, std_m)), colour in zip(curves.items(), ("#0072B2", "#E69F00", "#D55E00"), strict=True):
    axes.plot(time_s, std_m, color=colour, label=label)
axes.set_xlabel("time (s)")
axes.set_ylabel("bound of the position error (m)")
axes.set_xlim(0, 120)
axes.set_ylim(bottom=0)
axes.legend(title="clock offsets", frameon=False)
figure.savefig("bound.png")
figure.savefig("bound.pdf")
