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
