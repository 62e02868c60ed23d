"""torchbeam_envs: Gymnasium environments over torchbeam. Importing it registers them under "torchbeam/"."""

from typing import Any

import gymnasium

from .flutter_hold import FlutterHoldEnv, FlutterHoldVectorEnv
from .payload import PayloadEnv, PayloadVectorEnv
from .slew import SlewEnv, SlewVectorEnv
from .tip_reach import TipReachEnv, TipReachVectorEnv
from .tip_track import TipTrackEnv, TipTrackVectorEnv

__all__ = [
    "FlutterHoldEnv", "FlutterHoldVectorEnv", "PayloadEnv", "PayloadVectorEnv", "SlewEnv", "SlewVectorEnv", "TipReachEnv",
    "TipReachVectorEnv", "TipTrackEnv", "TipTrackVectorEnv",
]


def _register(task: str, steps: int, module: str, name: str, **arguments: Any) -> None:
    gymnasium.register(
        id=f"torchbeam/{task}-v0", entry_point=f"torchbeam_envs.{module}:{name}Env",
        vector_entry_point=f"torchbeam_envs.{module}:{name}VectorEnv", max_episode_steps=steps, kwargs=arguments,
    )


for _task, _module, _steps in (
    ("TipReach", "tip_reach", 50), ("TipTrack", "tip_track", 100), ("FlutterHold", "flutter_hold", 100),
    ("Payload", "payload", 100), ("Slew", "slew", 100),
):
    _register(_task, _steps, _module, _task)
    _register(f"{_task}Planar", _steps, _module, _task, planar=True)

_register(
    "TipReachBlockRate", 50, "tip_reach", "TipReach",
    section="silicone rod", length=0.3, elements=2, force=(0.08, 0.08), gravity=None, damping=None, form="block_rate",
    method="rk4", solver={"options": {"step_size": 5e-4}}, substeps=1, delay=0,
)
