"""Baselines: controllers without learning, to compare learned ones with.

A controller gets the reset by `begin(env)` and is then called with each observation (n, o), numpy
or torch; it answers with actions (n, a) of the same kind. All of them know the beam of the task
exactly, at its usual parameters.

    env = torchbeam_envs.TipReachVectorEnv(16)
    controller = LQR(env)
    observation, _ = env.reset(seed=0)
    controller.begin(env)
    env.step(controller(observation))
"""

from .estimated import AdaptiveMPC, Estimated
from .grasp import Grasp
from .holding import PD, Controller, Static, Zero, search
from .insert import Insert
from .linear import LQR, JointLQR
from .lqg import LQG, JointLQG
from .mpc import MPC
from .optimum import Optimum
from .resolved_rate import ResolvedRate
from .via_point import ViaPoint
from .waypoints import Waypoints

__all__ = [
    "LQG",
    "LQR",
    "MPC",
    "PD",
    "AdaptiveMPC",
    "Controller",
    "Estimated",
    "Grasp",
    "Insert",
    "JointLQG",
    "JointLQR",
    "Optimum",
    "ResolvedRate",
    "Static",
    "ViaPoint",
    "Waypoints",
    "Zero",
    "search",
]
