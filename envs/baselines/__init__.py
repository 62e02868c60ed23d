"""Controllers that learn nothing: what a learned one is to be compared with.

A controller is told of the reset by `begin(env)` and then called with each observation (n, o), numpy or torch; it answers with
actions (n, a) of the same kind. All of them know the beam of the task exactly, at its usual parameters.

    env = torchbeam_envs.TipReachVectorEnv(16)
    controller = LQR(env)
    observation, _ = env.reset(seed=0)
    controller.begin(env)
    env.step(controller(observation))
"""

from .holding import PD, Controller, Static, Zero
from .linear import LQG, LQR
from .optimum import Optimum

__all__ = ["LQG", "LQR", "PD", "Controller", "Optimum", "Static", "Zero"]
