"""Steady spin of a rotor on a support that does not spin: which parts turn about a bearing, and the
shape that both keep, the support as seen from frame a, the rotor as seen from axes that turn with
it.

Nodes of the rotor stand in a frame that turns with omega about the bearing's axis, as that is where
the support's deflection leaves it, all others in frame a. Loads and inertia are those of these
frames; nothing else knows of the spin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.arguments import place
from ..core.derivatives import cached, no_derivatives
from ..core.leaves import Tree, leaf, with_values
from ..core.validation import concrete, refusal
from ..equations.load_steps import climb
from ..equations.steady import Configuration, SteadyProblem
from ..nodal.conditions import Conditions, conditions
from ..nodal.discretise import discretise
from ..nodal.frame import FixedFrame, TranslatingFrame, TurningFrame
from ..nodal.model import Model
from ..scene.effects import Inputs
from ..scene.joints import Hinge
from ..scene.scene import Scene
from ..solvers.implicit_gradient import differentiated, implicit_gradient
from ..solvers.newton import newton
from ..state.state import State, rest

SAME = 1e-12  # of an axis, and of the structure's size: a bearing that does not move any more
ROUNDS = 30  # of the bearing's place and the equilibrium under it


class Axis(NamedTuple):
    """Of a bearing in frame a: point and direction (..., 3) m, 1."""

    point: Tensor
    direction: Tensor


@dataclass(frozen=True)
class Bearing(Tree):
    """A hinge about which a rotor spins, of a model in which it stands still.

    joint             its place among the scene's joints
    support, hub      rows of the nodes that it joins; None = the ground
    rotor             (nodes,) bool, what spins
    point, direction  (..., 3) of its axis as drawn, frame a
    """

    model: Model
    joint: int
    support: int | None
    hub: int
    rotor: Tensor = leaf(1)
    point: Tensor = leaf(1)
    direction: Tensor = leaf(1)

    @classmethod
    def of(cls, scene: Scene, bearing: int | None) -> Bearing:
        """Of a joint of the scene, None = its only hinge. Raises ValueError where there is none, or
        it does not part what spins from what stands.
        """
        at = _hinge(scene, bearing)
        hinge = scene.joints[at]
        held = dict.fromkeys(hinge.acts) | {"angle": 0.0}
        joints = [*scene.joints[:at], with_values(hinge, **held), *scene.joints[at + 1 :]]
        scene = replace(scene, joints=joints)
        a, b = hinge.ends
        if b is None:
            raise refusal("a bearing whose second part is the ground", "a rotor as its second part")
        turning = _connected(scene, b, at)
        if a is not None and turning[a]:
            raise ValueError(
                "a bearing was given to campbell whose two parts are connected otherwise too; a "
                "hinge that alone holds the rotor is wanted"
            )
        _refuse_held(scene, turning, at)
        rotor = torch.tensor(turning, device=scene.beam.nodes.device)
        point, _, axes = hinge.drawn(scene.beam)
        return cls(discretise(scene), at, a, b, rotor, point, axes[..., 0])

    def axis(self, x: Configuration) -> Axis:
        """Where the nodes stand at x."""
        if self.support is None:
            return Axis(self.point, self.direction)
        space, beam = self.model.space, self.model.scene.beam
        R = space.axes(x.rotation)[..., self.support, :, :] @ beam.axes[..., self.support, :, :].mT
        r = space.public_position(x.position)[..., self.support, :]
        lever = self.point - beam.nodes[..., self.support, :]
        lever, direction = ((R @ v[..., None])[..., 0] for v in (lever, self.direction))
        return Axis(r + lever, direction)

    def reduced(self, x: Configuration, point: Tensor) -> Tensor:
        """A point (..., 3) m of frame a in the space's coordinates (..., p)."""
        hub = self.model.space.public_position(x.position)[..., self.hub, :]
        return x.position[..., self.hub, :] + self.model.space.project_vector(point - hub)

    def frame(self, x: Configuration, speed: Tensor, axis: Axis) -> TurningFrame:
        """The frames of all nodes at a speed (...) rad/s."""
        space, mask = self.model.space, self.rotor[:, None]
        omega = space.project_spin(speed[..., None] * axis.direction)
        centre = self.reduced(x, axis.point)
        v = -(space.skew(omega) @ centre[..., None])[..., 0]
        v, omega = (torch.where(mask, y[..., None, :], 0.0) for y in (v, omega))
        return TurningFrame(space, TranslatingFrame(space, v), omega)


@dataclass(frozen=True)
class SpinningProblem(SteadyProblem):
    """Balance of nodes that stand in `own_frame`, each in its own."""

    own_frame: FixedFrame | None = None

    @cached
    def conditions(self) -> Conditions:
        now = conditions(self.model, self.t, self.inputs)
        return replace(now, frame=self.own_frame)


def steady_spin(
    bearing: Bearing, speed: Tensor, t: Tensor, inputs: Inputs
) -> tuple[SpinningProblem, State]:
    """The steady state at speeds (...) rad/s, with the problem that it solves. Raises RuntimeError
    for a speed without one.
    """
    model = bearing.model
    start = model.space.start(rest(model.scene))
    start = Configuration(start.position, start.rotation, start.stress)
    axis = bearing.axis(start)

    def problem_at(x: Configuration, axis: Axis) -> SpinningProblem:
        one = torch.ones_like(speed)
        return SpinningProblem(
            model, t, inputs, one, own_frame=bearing.frame(x, speed, axis)
        )

    with no_derivatives():
        problem = problem_at(start, axis)
        none = replace(problem, load_factor=torch.zeros_like(speed))
        x, reaction, status = climb(problem, none.apply_supports(start), None)
        for _ in range(ROUNDS):
            now = bearing.axis(x)
            if concrete(status != 0).any() or _near(axis, now, model):
                break
            axis, problem = now, problem_at(x, now)
            x, reaction, status, _ = newton(problem, x)
    _refuse_failed(speed, status)
    problem = problem_at(x, bearing.axis(x))
    if differentiated(problem, x):
        for _ in range(1 if bearing.support is None else ROUNDS):
            before = x
            x, reaction = implicit_gradient(problem, x, status == 0)
            problem = problem_at(x, bearing.axis(x))
            if _near(bearing.axis(before), bearing.axis(x), model):
                break
    return problem, problem.state(x, reaction, status)


def _near(a: Axis, b: Axis, model: Model) -> bool:
    size = model.scene.beam.extent.detach()[..., None]
    moved = (a.point - b.point).abs() / size, (a.direction - b.direction).abs()
    return all(bool(concrete(v <= SAME).all()) for v in moved)


def _refuse_failed(speed: Tensor, status: Tensor) -> None:
    failed = concrete(status != 0)
    if failed.any():
        first = float(concrete(speed).expand(failed.shape)[failed][0])
        raise RuntimeError(
            f"no steady state of the rotor was found at {first:.4g} rad/s; lower speeds, or a rotor "
            "that keeps its balance there, are wanted"
        )


def _hinge(scene: Scene, bearing: int | None) -> int:
    """Which joint of a scene."""
    hinges = [k for k, joint in enumerate(scene.joints) if isinstance(joint, Hinge)]
    if bearing is None:
        if len(hinges) != 1:
            raise ValueError(
                f"a scene with {len(hinges)} hinges was given to campbell; bearing=, the number of "
                "the joint about which the rotor spins, is wanted"
                if hinges
                else "a scene without a Hinge was given to campbell; one about which the rotor "
                "spins is wanted"
            )
        return hinges[0]
    bearing = place("bearing", bearing, len(scene.joints), "joints")
    if bearing not in hinges:
        raise refusal(f"bearing = {bearing}, a {scene.joints[bearing].called},", "a Hinge")
    return bearing


def _connected(scene: Scene, start: int, without: int) -> list[bool]:
    """Of each node whether it is connected with `start`, by anything but a joint `without`."""
    beam = scene.beam
    ties: list[Any] = [tuple(range(part.nodes.start, part.nodes.stop)) for part in beam.parts]
    ties += [joint.ends for k, joint in enumerate(scene.joints) if k != without]
    ties += [x.nodes for x in (*scene.tendons, *scene.interactions)]
    reached, grew = {start}, True
    while grew:
        grew = False
        for tie in ties:
            nodes = {node for node in tie if node is not None}
            if reached & nodes and not nodes <= reached:
                reached, grew = reached | nodes, True
    return [node in reached for node in range(beam.node_count)]


def _refuse_held(scene: Scene, turning: list[bool], bearing: int) -> None:
    """ValueError for a rotor that something beside the bearing holds to frame a."""
    if any(turning[support.node] for support in scene.supports):
        raise ValueError(
            "a support of the rotor was given to campbell; supports of what stands are wanted"
        )
    others = (joint.ends for k, joint in enumerate(scene.joints) if k != bearing)
    if any(turning[node] for ends in others if None in ends for node in ends if node is not None):
        raise ValueError(
            "a joint of the rotor with the ground beside its bearing was given to campbell; a "
            "rotor that its bearing alone holds is wanted"
        )
    if scene.frame is not None or any(support.moves for support in scene.supports):
        raise ValueError(
            "a scene whose frame or support moves was given to campbell; a bearing whose rotor "
            "spins in a frame at rest is wanted (of what turns as a whole `modes` tells)"
        )
    if scene.pairs:
        raise ValueError("contact of two parts was given to campbell; none is wanted there")

