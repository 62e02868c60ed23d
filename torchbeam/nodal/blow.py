"""Joints that are led, with a jump from the state that a run starts from."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.validation import concrete
from ..core.warning import warn
from ..scene.effects import Input
from .model import Model

SOON = 1 / 8  # of a step
CLOSED = 1e-5  # rad, of a turn, or m
TURNING = 0.3  # of the state's rate; from 1/4 on no step over a turning point is a jump


def warn_of_blow(model: Model, state: Any, dt: Tensor) -> None:
    """Warns where what a coordinate does over SOON of the first step, of dt (...) s, differs from
    the state's motion by more than half of what it does over that step.
    """
    scene, joints = model.scene, model.joints
    led = [joint.law(k).prescribed for joint in scene.joints for k in joint.coordinates]
    if all(value is None or isinstance(value, Input) for value in led):
        return
    with no_derivatives():
        x, wide = model.space.to_reduced(state), dt[..., None, None]

        def coordinates(share: float, value: float = 0.0) -> Any:
            inputs = {name: x.t.new_full((size,), value) for name, size in scene.inputs.items()}
            return joints.value(scene.joints, "prescribed", x.t + share * dt, inputs)

        start, soon, end = map(coordinates, (0, SOON, 1))
        pose = joints.pose(x.position, x.rotation)
        rate = joints.rate(pose, x.velocity, x.spin)
        change = (soon - joints.coordinate(pose, start)) / (SOON * wide) - rate
        most = ((end - start).abs() + CLOSED * (1 + start.abs())) / wide + TURNING * rate.abs()
        rows = joints.prescribed * change.abs() > most / 2
        if scene.inputs:  # by which coordinates may be led, to wherever a user says
            rows = rows & (coordinates(0, 1.0) == start)
        blow = concrete(rows.reshape(-1, *joints.prescribed.shape).any(0).any(-1))
    if blow.any():
        which = int(blow.nonzero()[0, -1])
        warn(
            f"joint {which}, a {scene.joints[which].called}, is led with a jump of its coordinate "
            "or rate from the initial state: a blow, by which rates and loads may alternate from "
            "step to step. A smooth start is wanted, 2 * t**2 from rest, or a state that moves so",
            UserWarning,
        )
