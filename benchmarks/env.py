"""Gymnasium environments: `import cellslam.benchmarks.env` registers them.

`cellslam/Localization-v0`: an episode is a drive, the agent says where it believes to have moved.
"""

from __future__ import annotations

from gymnasium.envs.registration import register, registry

LOCALIZATION = "cellslam/Localization-v0"

if LOCALIZATION not in registry:
    register(LOCALIZATION, entry_point="cellslam.benchmarks.env_localization:LocalizationEnv")
