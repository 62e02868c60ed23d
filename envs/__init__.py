"""torchbeam_envs: Gymnasium environments over torchbeam. Importing it registers them under "torchbeam/"."""

import gymnasium

from .tip_reach import TipReachEnv, TipReachVectorEnv

__all__ = ["TipReachEnv", "TipReachVectorEnv"]

gymnasium.register(
    id="torchbeam/TipReach-v0",
    entry_point="torchbeam_envs.tip_reach:TipReachEnv",
    vector_entry_point="torchbeam_envs.tip_reach:TipReachVectorEnv",
    max_episode_steps=50,
)

gymnasium.register(
    id="torchbeam/TipReachBlockRate-v0",
    entry_point="torchbeam_envs.tip_reach:TipReachEnv",
    vector_entry_point="torchbeam_envs.tip_reach:TipReachVectorEnv",
    max_episode_steps=50,
    kwargs={
        "section": "silicone rod", "length": 0.3, "elements": 2, "force": (0.08, 0.08), "gravity": None, "damping": None,
        "form": "block_rate", "method": "rk4", "solver": {"options": {"step_size": 5e-4}}, "substeps": 1, "delay": 0,
    },
)
