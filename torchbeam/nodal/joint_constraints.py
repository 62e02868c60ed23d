"""Constraints of a scene's joints, as products of two vectors: see `joints`.

Of small rotations theta, axes are (I + ~theta) F, and each row is linear in the nodes' moves: v is
as drawn, and of a rotation w is what it is in one part less what it is in the other,

    F_a,i . (p_b - p_a)        -F_y . (theta_b - theta_a) x F_z        d_0/L . d - L
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.leaves import AXES, with_values
from ..core.remembered import remembered
from ..math import quaternions as quat
from ..scene.ball import Ball
from ..scene.joint import Joint
from ..scene.scene import Scene
from ..scene.structure import Structure, unstressed
from .balls import BallLaws, Balls, SmallBallLaws
from .between_nodes import BetweenNodes
from .coordinate_laws import coordinate_laws_of
from .coordinates.spatial import Spatial
from .driven_joints import DrivenJoints
from .joint_laws import JointLaws
from .joint_motion import Factor
from .joints import Joints

# the axes of a and of b that a turn about this one brings together, and the sign of their product
TURNS = {"x": ("y", "z", -1.0), "y": ("z", "x", -1.0), "z": ("x", "y", -1.0)}
# where x is common to both: the other two then hold its direction, whatever the angle
ABOUT_X = TURNS | {"z": ("y", "x", 1.0)}


@dataclass(frozen=True)
class Vector:
    """constant (..., 3) + shift (...) (r_b - r_a) + R_a in_a + R_b in_b; parts: 1.0 for those of
    constant, in_a and in_b that are there, whatever they are, else 0.0.
    """

    constant: Tensor
    shift: Tensor
    in_a: Tensor
    in_b: Tensor
    parts: tuple[float, float, float]

    def __add__(self, other: Vector) -> Vector:
        return Vector(
            self.constant + other.constant,
            self.shift + other.shift,
            self.in_a + other.in_a,
            self.in_b + other.in_b,
            tuple(map(max, self.parts, other.parts)),
        )

    def times(self, factor: Tensor | float) -> Vector:
        factor = torch.as_tensor(factor, dtype=self.constant.dtype, device=self.constant.device)
        return Vector(
            self.constant * factor[..., None],
            self.shift * factor,
            self.in_a * factor[..., None],
            self.in_b * factor[..., None],
            self.parts,
        )


@dataclass(frozen=True)
class End:
    """One part of a joint, at rest: its node (None = the ground), at r (..., 3) with the axes R
    (..., 3, 3); point p of the joint. turns: False for small rotations, which add ~theta e to e.
    """

    second: bool
    ground: bool
    r: Tensor
    R: Tensor
    p: Tensor
    turns: bool

    @classmethod
    def of(cls, beam: Any, node: int | None, second: bool, p: Tensor, turns: bool) -> End:
        at = 0 if node is None else node
        r, R = beam.nodes[..., at, :], quat.matrix(beam.frames[..., at, :])
        return cls(second, node is None, r, R, p, turns)

    def direction(self, e: Tensor) -> Vector:
        """What at rest is e (..., 3), frame a."""
        zero = torch.zeros_like(e)
        local = e if self.ground else (self.R.mT @ e[..., None])[..., 0]
        place = 0 if self.ground else 2 if self.second else 1
        constant, in_a, in_b = (local if k == place else zero for k in range(3))
        there = tuple(float(k == place) for k in range(3))
        if not self.turns:
            constant, there = e, (1.0, *there[1:])
        return Vector(constant, zero[..., 0], in_a, in_b, there)

    def line(self, e: Tensor) -> Vector:
        """The first of two vectors likewise: of small rotations it stays as drawn."""
        end = self if self.turns else dataclasses.replace(self, ground=True)
        return end.direction(e)

    def crossed(self, e: Tensor, other: End) -> Vector:
        """The second one, across a line of the other part: of small rotations less what it is
        there, which turns with the line.
        """
        here = self.direction(e)
        return here if self.turns else here + other.direction(e).times(-1.0)

    @property
    def arm(self) -> Vector:
        """From the node, or from the origin, to the joint."""
        return self.direction(self.p if self.ground else self.p - self.r)


def joints_of(scene: Scene, space: Spatial, topology: Any) -> Any:
    """`Joints` of a scene, or none."""
    if not scene.joints:
        return BetweenNodes()
    bare = tuple(map(_without_laws, scene.joints))
    fields = remembered(_reference_joints, bare, unstressed(scene.beam), space, topology)
    behind = sum(bool(interaction.unknowns) for interaction in scene.interactions)
    fields = fields | dict(space=space, framework=topology, balls=_balls(scene), behind=behind)
    if not any(joint.acts for joint in scene.joints):
        return Joints(**fields)
    second, like = fields["second"], scene.beam.nodes
    rows = fields["angles"] + fields["travels"] - second, second
    prescribed = sum(
        mask * like.new_tensor([[joint.law(k).prescribed is not None] for joint in scene.joints])
        for k, mask in enumerate(rows)
    )
    names = (field.name for field in dataclasses.fields(JointLaws))
    laws = JointLaws(**{name: _given(scene.joints, name, rows) for name in names})
    held = fields["held"] + prescribed
    return DrivenJoints(
        **fields | dict(held=held),
        laws=laws,
        prescribed=prescribed,
        own_laws=coordinate_laws_of(scene.joints, like),
    )


def _without_laws(joint: Joint) -> Joint:
    """What says where it is and what it holds."""
    return with_values(joint, **dict.fromkeys(joint.acts))


def _reference_joints(
    joints: tuple[Joint, ...], beam: Structure, space: Spatial, topology: Any
) -> dict[str, Any]:
    """Fields of `Joints` that follow from how parts are drawn."""
    each = [_rows(joint, beam, space) for joint in joints]
    J, m = len(each), space.unknowns

    def stacked(parts: list[Tensor], axes: int) -> Tensor:
        return torch.stack(torch.broadcast_tensors(*parts), -1 - axes).unflatten(-1 - axes, (J, m))

    def factor(name: str) -> Factor:
        factors = [getattr(row, name) for rows in each for row in rows]
        arms = (stacked([getattr(x, name) for x in factors], 1) for name in ("in_a", "in_b"))
        fixed = torch.stack(torch.broadcast_tensors(*arms), -3)
        return Factor(
            stacked([x.constant for x in factors], 1),
            stacked([x.shift for x in factors], 0)[..., None],
            fixed,
        )

    def mask(which: Callable[[Constraint], bool]) -> Tensor:
        return like.new_tensor([[float(which(row)) for row in rows] for rows in each])

    turns = ("angle",) if space.turns else ()  # small ones are as travels are

    like = beam.nodes
    places = [x for joint in joints for x in joint.drawn(beam)[:2]]
    size = beam.size_with(torch.stack(torch.broadcast_tensors(*places), -2)).detach()
    # fmt: off
    return dict(
        held=mask(lambda row: row.held), v=factor("v"),
        w=factor("w"), across=factor("across"),
        parts=like.new_tensor([[[row.v.parts, row.w.parts, row.across.parts] for row in rows]
                               for rows in each]),
        c=stacked([row.c for rows in each for row in rows], 0),
        moves=space.embed(torch.eye(m, dtype=like.dtype, device=like.device)),
        # 1 m of a body that turns about its own centre, where nothing has a length
        size=torch.where(size > 0, size, 1.0),
        angles=mask(lambda row: row.coordinate in turns),
        travels=mask(lambda row: row.coordinate not in (None, *turns)),
        second=mask(lambda row: row.second))
    # fmt: on


def _given(joints: tuple[Any, ...], name: str, rows: tuple[Tensor, Tensor]) -> Tensor | None:
    """A law's number of each joint, in its rows (J, w) of first and of second coordinates; None
    where no joint has one.
    """
    total = None
    for k, mask in enumerate(rows):
        values = _side_by_side(
            [getattr(joint.law(k), name) for joint in joints], mask.new_zeros(())
        )
        if values is not None:
            part = values[..., None] * mask
            total = part if total is None else total + part
    return total


def _side_by_side(values: list[Tensor | None], none: Tensor) -> Tensor | None:
    """Values of all joints (..., J, *), `none` (*) in the place of those that are not there; None
    where no joint has one.
    """
    if all(value is None for value in values):
        return None
    each = torch.broadcast_tensors(*(none if value is None else value for value in values))
    return torch.stack(each, -1 - none.ndim)


class Constraint(NamedTuple):
    """A constraint v . w = c of a joint, one that it does not hold as well: it may be its
    coordinate, "travel" or "angle", its `second`, of which a travel always is. across: what w
    becomes by a right angle, in the row of an angle.
    """

    v: Vector
    w: Vector
    c: Tensor
    held: bool
    across: Vector
    coordinate: str | None = None
    second: bool = False


def _rows(joint: Any, beam: Any, space: Spatial) -> list[Constraint]:
    """The m constraints of a joint, those that it does not have as well."""
    at_a, at_b, axes = joint.drawn(beam)
    ends = zip(joint.ends, (False, True), (at_a, at_b), strict=True)
    a, b = (End.of(beam, *end, space.turns) for end in ends)
    apart = b.arm + a.arm.times(-1.0)
    apart = dataclasses.replace(apart, shift=torch.ones_like(apart.shift))
    names = dict(zip("xyz", axes.unbind(-1), strict=True))
    along, about = (
        ("xyz", "xyz") if space.plane is None else _of_plane(joint, names, space.basis[:, 2])
    )
    none = apart.shift * 0.0
    nothing = dataclasses.replace(apart.times(0.0), parts=(0.0, 0.0, 0.0))
    rows = [
        Constraint(
            a.line(names[i]),
            apart,
            none,
            i in joint.position,
            nothing,
            "travel" if i == "x" and joint.position == "yz" else None,
            i == "x" and joint.position == "yz",
        )
        for i in along
    ]
    turns = ABOUT_X if joint.rotation == "yz" else TURNS
    for k in about:
        i, j, sign = turns[k]
        if k in "xy" and joint.rotation == "z":  # see `Universal`: x is fixed in a, y in b
            v, w, across = (b, "y"), (a, "z"), (a, "y")
            if k == "y":
                v, w, across = (a, "x"), (b, "z"), (b, "x")
            (v, line), (w, axis), (end, other) = v, w, across
            v, w = v.line(names[line]), w.crossed(names[axis], v)
            across = end.direction(names[other]).times(-1.0)
            rows.append(Constraint(v, w, none, False, across, "angle", k == "y"))
            continue
        free = k == "x" and joint.rotation == "yz"
        rows.append(
            Constraint(
                a.line(names[i]).times(sign),
                b.crossed(names[j], a),
                none,
                k in joint.rotation,
                b.direction(names["y"]) if free else nothing,
                "angle" if free else None,
            )
        )
    if joint.distance:
        L = torch.linalg.vector_norm(at_b - at_a, dim=-1)
        length = Constraint(apart.times(0.5 / L), apart, L / 2, True, nothing)
        if not space.turns:
            length = length._replace(v=a.line((at_b - at_a) / L[..., None]), c=L)
        rows = [length, *(row._replace(held=False) for row in rows[1:])]
    return rows


def _balls(scene: Scene) -> Balls | None:
    """The joints of a scene that leave all turns, of which something may be read and act."""
    joints, like = scene.joints, scene.beam.nodes
    at = tuple(k for k, joint in enumerate(joints) if isinstance(joint, Ball))
    if not at:
        return None
    ground = [[[[float(end is None)]] for end in joint.ends] for joint in joints]
    eye = torch.eye(3, dtype=like.dtype, device=like.device)
    axes = quat.matrix(scene.beam.frames).mT
    ends = ([eye if end is None else axes[..., end, :, :] for end in x.ends] for x in joints)
    end_axes = [torch.stack(torch.broadcast_tensors(*both), -3) for both in ends]
    laws = {}
    for field in dataclasses.fields(BallLaws):
        values = [getattr(x, field.name) if k in at else None for k, x in enumerate(joints)]
        none = like.new_zeros((3,) * (field.metadata[AXES] - 1))
        laws[field.name] = _side_by_side(values, none)
    if laws["limit"] is None:
        laws["axis"] = None
    else:
        size = torch.linalg.vector_norm(laws["axis"], dim=-1, keepdim=True)
        laws["axis"] = laws["axis"] / torch.where(size > 0, size, 1.0)
    end_axes = torch.stack(torch.broadcast_tensors(*end_axes), -4)
    torques = any(joints[k].torque is not None for k in at)
    own_laws = (SmallBallLaws if scene.small else BallLaws)(**laws)
    return Balls(at, like.new_tensor(ground), end_axes, own_laws, torques)


def _of_plane(joint: Any, axes: dict[str, Tensor], normal: Tensor) -> tuple[str, str]:
    """Names of the joint's axes in the plane, and of the one along its normal: z, where x alone is
    given, and in the plane.
    """
    across = {name: float((e.detach() @ normal).abs().min()) for name, e in axes.items()}
    out = max(across, key=across.get)
    if out != "x" and joint.position[-2:] == "yz" and joint.rotation != "z":  # y and z are alike
        axes["z"], out = normal.expand_as(axes["x"]), "z"
        axes["y"] = torch.linalg.cross(axes["z"], axes["x"])
    return "".join(name for name in "xyz" if name != out), out
