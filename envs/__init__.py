"""torchbeam_envs: Gymnasium environments over torchbeam. Importing it registers them under
"torchbeam/".

    gymnasium.make("torchbeam/TipReach-v1")
    gymnasium.make_vec("torchbeam/TipReach-v1", num_envs=256)
    TipReachVectorEnv(256, output="torch")       tensors, differentiable end to end

What an environment of one's own is made of: `Task`, `BeamEnvConfig`, `Actuator`, `TipForce`,
`Observed`, `Parameter`, behind `BeamVectorEnv` and `SingleEnv` (docs/own_environment.md).
`functional`: episodes as values, begun and stepped by functions. `Sb3VecEnv` puts a vector env into
stable-baselines3 (extra `rl`).

Examples in docstrings go on from these lines:

>>> import torch
>>> import torchbeam as tb
>>> import torchbeam_envs as envs
>>> from torchbeam_envs import baselines
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

import gymnasium

from torchbeam.extend import entry_point, entry_points

from . import functional
from .actuators import Actuator, TipForce
from .config import BeamEnvConfig
from .core import BeamVectorEnv
from .episodes import Episodes
from .flutter_hold import FlutterHoldEnv, FlutterHoldVectorEnv
from .follow_target import FollowTargetEnv, FollowTargetVectorEnv
from .gripper import GripperEnv, GripperVectorEnv
from .inverse_kinematics import InverseKinematicsEnv, InverseKinematicsVectorEnv
from .parameters import Parameter
from .payload import PayloadEnv, PayloadVectorEnv
from .peg import PegEnv, PegVectorEnv
from .plant import aluminium_strip, silicone_rod
from .reach import holding_action
from .reach_behind import ReachBehindEnv, ReachBehindVectorEnv
from .reach_obstacles import ReachObstaclesEnv, ReachObstaclesVectorEnv
from .reach_pose import ReachPoseEnv, ReachPoseVectorEnv
from .sensors import Observed
from .single import SingleEnv
from .slew import SlewEnv, SlewVectorEnv
from .task import Task
from .tip_reach import TipReachEnv, TipReachVectorEnv
from .tip_track import TipTrackEnv, TipTrackVectorEnv
from .track_target import TrackTargetEnv, TrackTargetVectorEnv
from .two_link import TwoLinkEnv, TwoLinkVectorEnv
from .uncertain import UNCERTAIN

if TYPE_CHECKING:
    from .sb3 import Sb3VecEnv

# fmt: off
__all__ = [
    "UNCERTAIN", "Actuator", "BeamEnvConfig", "BeamVectorEnv", "Episodes", "FlutterHoldEnv",
    "FlutterHoldVectorEnv", "FollowTargetEnv", "FollowTargetVectorEnv", "GripperEnv",
    "GripperVectorEnv", "InverseKinematicsEnv", "InverseKinematicsVectorEnv", "Observed",
    "Parameter", "PayloadEnv", "PayloadVectorEnv", "PegEnv", "PegVectorEnv", "ReachBehindEnv",
    "ReachBehindVectorEnv", "ReachObstaclesEnv", "ReachObstaclesVectorEnv", "ReachPoseEnv",
    "ReachPoseVectorEnv", "Sb3VecEnv", "SingleEnv", "SlewEnv", "SlewVectorEnv", "Task", "TipForce",
    "TipReachEnv", "TipReachVectorEnv", "TipTrackEnv", "TipTrackVectorEnv", "TrackTargetEnv",
    "TrackTargetVectorEnv", "TwoLinkEnv", "TwoLinkVectorEnv", "aluminium_strip", "functional",
    "holding_action", "silicone_rod",
]
# fmt: on
LAZY = {"Sb3VecEnv": "sb3"}  # what wants an extra, by module
entry_points(globals(), __all__)


def __getattr__(name: str) -> Any:
    if name in LAZY:
        return entry_point(getattr(import_module(f".{LAZY[name]}", __name__), name))
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


# those of which are not the first
SECOND_VERSIONS = (
    "TipReach", "TipTrack", "FlutterHold", "Slew", "TwoLink", "Peg", "Gripper", "FollowTarget",
    "InverseKinematics",
)  # fmt: skip
VERSIONS = dict.fromkeys(SECOND_VERSIONS, 1) | {"Payload": 2}


def _register(
    task: str, steps: int, module: str, name: str, version: int | None = None, **arguments: Any
) -> None:
    version = VERSIONS.get(name, 0) if version is None else version
    gymnasium.register(
        id=f"torchbeam/{task}-v{version}",
        entry_point=f"torchbeam_envs.{module}:{name}Env",
        vector_entry_point=f"torchbeam_envs.{module}:{name}VectorEnv",
        max_episode_steps=steps,
        kwargs=arguments,
    )


for _task, _module, _steps in (
    ("TipReach", "tip_reach", 50),
    ("TipTrack", "tip_track", 100),
    ("FlutterHold", "flutter_hold", 100),
    ("Payload", "payload", 100),
    ("Slew", "slew", 100),
    ("TwoLink", "two_link", 100),
    ("FollowTarget", "follow_target", 500),
    ("ReachObstacles", "reach_obstacles", 50),
    ("Peg", "peg", 100),
    ("Gripper", "gripper", 100),
):
    _register(_task, _steps, _module, _task)
    _register(f"{_task}Planar", _steps, _module, _task, planar=True)

_register("InverseKinematics", 100, "inverse_kinematics", "InverseKinematics")
_register("TrackTarget", 7142, "track_target", "TrackTarget")
_register("ReachPose", 1428, "reach_pose", "ReachPose")
_register("ReachBehind", 3571, "reach_behind", "ReachBehind")
_register("ReachBehindNest", 3571, "reach_behind", "ReachBehind", nest=True)
_register(
    "TipReachBlockRate",
    50,
    "tip_reach",
    "TipReach",
    section="silicone rod",
    length=0.3,
    elements=2,
    force=(0.08, 0.08),
    gravity=None,
    damping=None,
    form="block_rate",
    method="rk4",
    solver={"options": {"step_size": 5e-4}},
    substeps=1,
    delay=0,
)
