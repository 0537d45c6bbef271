"""Gymnasium environments: `import cellslam.benchmarks.env` registers them.

`cellslam/Localization-v0`: an episode is a drive, the agent says where it believes to have moved.
`cellslam/ActiveSlam-v0`: the agent drives along the route, an estimator runs inside.

Many episodes at once, as arrays: `gym.make_vec("cellslam/Localization-v0", num_envs=256)`. Asynchronous vector
environments, of others and of wrapped ones:
`gym.make_vec(..., vectorization_mode="async", vector_kwargs={"context": "spawn"})`; compiled parallel code does not
survive a fork.
"""

from __future__ import annotations

from gymnasium.envs.registration import register, registry

LOCALIZATION = "cellslam/Localization-v0"
ACTIVE_SLAM = "cellslam/ActiveSlam-v0"

if LOCALIZATION not in registry:
    register(
        LOCALIZATION,
        entry_point="cellslam.benchmarks.env.localization:LocalizationEnv",
        vector_entry_point="cellslam.benchmarks.env.vector_localization:LocalizationVectorEnv",
    )
if ACTIVE_SLAM not in registry:
    register(ACTIVE_SLAM, entry_point="cellslam.benchmarks.env.active_slam:ActiveSlamEnv")
