"""The uncertain level of tasks: keywords under which plants, actuators and sensors are no better
known than to a real controller. The nominal level is a task's defaults.

    gymnasium.make_vec("torchbeam/TipReach-v1", num_envs=256, **UNCERTAIN["TipReach"])
"""

from __future__ import annotations

from typing import Any

BEAM = {"stiffness": (0.7, 1.3), "damping": (1e-3 / 3, 3e-3)}  # damping of 1 ms, a factor of 3
BETWEEN = {"latency": (0.0, 2.0), "lag": (0.0, 0.02), "gain": (0.9, 1.1), "bias": (0.0, 0.01)}
HELD = {"clamp": (0.001, 0.05)}  # of a clamped beam
NOISE = 0.005


def _level(*parts: dict[str, tuple[float, float]], **more: tuple[float, float]) -> dict[str, Any]:
    drawn = {name: bounds for part in parts for name, bounds in part.items()}
    return {"randomize": {**drawn, **BETWEEN, **more}, "noise": NOISE}


# by task: keywords beside its own
UNCERTAIN: dict[str, dict[str, Any]] = {
    "TipReach": _level(BEAM, HELD, tip_mass=(0.0, 0.024)),  # a fifth of the strip's mass
    "TipTrack": _level(BEAM, HELD, tip_mass=(0.0, 0.024)),
    "Payload": _level(BEAM, HELD, payload=(0.05, 0.15)),
    "Slew": _level(BEAM, tip_mass=(0.0, 0.024)),
    "FlutterHold": _level(BEAM, HELD),
}
