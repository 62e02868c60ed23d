"""Which unknowns a scene asks for, and whether what acts on it stays in its plane."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from ..effects import Spring
from ..scene import Scene
from .external import Nodes
from .plane import Plane
from .small import Small
from .space import Space

if TYPE_CHECKING:
    from .model import Model

ROUNDING = 1e-9  # of a vector, that may lie out of a plane


def space_of(scene: Scene) -> Space:
    """The space of a scene whose plane is not "auto". Raises ValueError where the beam, the motion of its frame or follower
    loads do not fit it.
    """
    if scene.small:
        if scene.plane is not None:
            raise ValueError("plane and small were given; one of them is wanted")
        if scene.frame is not None and scene.frame.angular_velocity is not None:
            raise ValueError("small=True in a frame that turns was given; large rotations (small=False) are wanted there")
        for load in scene.loads:
            if getattr(load, "follower", False) or load.wants_support:
                raise ValueError(f"small=True with {type(load).__name__} was given, whose load turns with the beam; dead loads "
                                 "are wanted")
        return Small.of(scene)
    return Space() if scene.plane is None else Plane.of(scene, scene.plane)


def only_numbers(scene: Scene) -> bool:
    """Whether nothing acts or moves by a function or an input: only then can a plane be found."""
    values = [v for effect in scene.effects for v in effect.values]
    motions = [m for s in (scene.root, *scene.supports) if s is not None for m in vars(s).values()]
    motions += [] if scene.frame is None else [scene.frame.velocity, scene.frame.angular_velocity]
    functions = any(hasattr(effect, "function") for effect in scene.effects) or any(callable(m) for m in motions)
    return not functions and all(hasattr(v, "shape") for v in values)


def check_plane(model: Model, whole: Model) -> None:
    """Refuse numbers that act out of the plane: loads on the beam at rest, the points that springs are tied to, what the beam
    bends by itself, masses that are not alike on both sides, motions of the frame and of supports. `whole` is the model in 3D.
    Raises ValueError.
    """
    scene, space, beam = model.scene, model.space, model.scene.beam
    still = torch.zeros_like(beam.nodes)
    t = still.new_zeros(())
    for load in scene.loads:
        if all(hasattr(v, "shape") for v in load.values) and not hasattr(load, "function"):
            wrench = whole.external(Nodes(beam.nodes, beam.frames, still, still), t, {}, (load,))
            _refuse(space, type(load).__name__, wrench, space.whole(space.part(wrench)))
        if isinstance(load, Spring) and isinstance(load.to, (Tensor, np.ndarray)):  # slack at rest, it pulls nowhere
            to = torch.as_tensor(load.to).to(still) - beam.nodes[..., load.node, :]
            _refuse(space, "a Spring to a point", to, space.part_of_vector(to) @ space.basis[:, :2].mT)
    for effect in scene.eigenstrains:
        if all(hasattr(v, "shape") for v in effect.values):
            own = effect.eigenstrain(t, {}, model.length, model.count)
            _refuse(space, type(effect).__name__, own, space.whole_strain(space.part_of_strain(own)))
    for body in scene.bodies:
        if body.offset is not None:
            e = torch.as_tensor(body.offset, dtype=scene.dtype, device=scene.device)
            _refuse(space, "PointMass", e, space.part_of_offset(e) @ space.section[:, :2].mT)
        if body.inertia is not None:
            J = space.section.mT @ torch.as_tensor(body.inertia, dtype=scene.dtype, device=scene.device) @ space.section
            across = J[..., 2:, :] * J.new_tensor((1.0, 1.0, 0.0))  # products of inertia with the normal
            _refuse(space, "PointMass", J[..., 2:, :], J[..., 2:, :] - across)
    motions = [] if scene.frame is None else [("a frame with a velocity", scene.frame.velocity, False),
                                              ("a frame that turns", scene.frame.angular_velocity, True)]
    for one in scene.supports:
        motions += [("a displacement of a support", one.displacement, False), ("a turn of a support", one.turn, True)]
    for what, x, turns in motions:
        if isinstance(x, Tensor):
            x = x.to(still)
            inside = space.part_of_spin(x) @ space.basis[:, 2:].mT if turns else space.part_of_vector(x) @ space.basis[:, :2].mT
            _refuse(space, what, x, inside)


def _refuse(space: Plane, what: str, given: Tensor, inside: Tensor) -> None:
    out = (given - inside).detach().abs()
    if (out > ROUNDING * given.detach().abs().amax()).any():
        raise ValueError(f"{what} out of the plane {space.name!r} was given; one in it is wanted, or plane=None")
