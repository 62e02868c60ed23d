"""Joints in native code: constants, kinds and local functions of them, and of the nodes that they
sit at: the interface between the runs of nodes that are eliminated, see
`topology.framework_system`.

A joint's two ends are called i and j, as those of an element; of the ground there are no fields.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ...core.leaves import Tree, leaf
from ...equations.balance_problem import BalanceProblem
from ...nodal.balls import Balls
from ...nodal.coordinate_laws import CoordinateLaws
from ...nodal.joint_laws import JointLaws
from ...nodal.joint_motion import Factor, JointValues
from ...nodal.joints import Joints
from ...nodal.model import Model
from ...nodal.rows import Rows
from ...scene.effects import Inputs
from ...state.instant import READINGS
from ...state.state import State
from ...topology.framework import Framework
from .chain_constants import filled
from .interaction_functions import FORCES, InteractionFunctions, Later, Several, of_ends
from .local_problem import Fields
from .row_kinds import EndKind, sides_of, tuples_of
from .sorts import OWN, SIDES, Edge, Edges, Sort


@dataclass(frozen=True)
class JointConstants(Tree):
    """Rows of joints, see `Joints` and `DrivenJoints`; effort, coordinate: of `JointValues`;
    balls: of all joints, of which kinds say whether they are some.
    """

    v: Factor
    w: Factor
    c: Tensor = leaf(2)
    across: Factor
    laws: JointLaws | None
    effort: Tensor | None = leaf(2)
    coordinate: Tensor | None = leaf(2)
    balls: Balls | None
    own_laws: CoordinateLaws | None


class JointKind(NamedTuple):
    """What code of a joint depends on: what holds its two ends, None = it is the ground; its rows
    of `Joints.held`, `angles`, `travels`, `second` and, where there are any, `prescribed`; of v, w
    and across the shift, row by row, None = a value; its rows of `Joints.parts`; whether it is a
    ball; how many numbers a state has of it; the numbers of its own laws.
    """

    ends: tuple[EndKind | None, EndKind | None]
    held: tuple[float, ...]
    angles: tuple[float, ...]
    travels: tuple[float, ...]
    second: tuple[float, ...]
    prescribed: tuple[float, ...] | None
    shifts: tuple[tuple[float | None, ...], ...]
    parts: tuple[tuple[tuple[float, ...], ...], ...]
    ball: bool = False
    kept: int = READINGS
    own_laws: tuple[int, ...] = ()
    multiplied: ClassVar[bool] = True
    told: ClassVar[int] = 0

    sides = property(lambda self: sides_of(self.ends))


@dataclass(frozen=True)
class JointFunctions(InteractionFunctions):
    """Functions of a joint."""

    @staticmethod
    def edges(model: Model) -> Edges:
        if not model.joints.count:
            return ()
        w, counts = model.space.unknowns, map(int, model.joints.held.sum(-1))
        pairs = zip(model.topology.joints, counts, strict=True)
        return tuple(Edge(nodes, count, count == w) for nodes, count in pairs)

    @staticmethod
    def kinds(model: Model, held: list[EndKind], several: Several) -> tuple[JointKind, ...]:
        joints = model.joints
        if not joints.count:
            return ()
        masks = [joints.held, joints.angles, joints.travels, joints.second]
        prescribed = getattr(joints, "prescribed", None)
        masks = [
            *map(tuples_of, masks),
            [None] * joints.count if prescribed is None else tuples_of(prescribed),
        ]
        at = () if joints.balls is None else joints.balls.at
        balls = [k in at for k in range(joints.count)]
        kept = [_numbers_of(model)] * joints.count
        own_laws = getattr(joints, "own_laws", None)
        laws = [()] * joints.count if own_laws is None else own_laws.kinds
        factors = joints.v, joints.w, joints.across
        shifts = zip(*(_shifts(factor.shift) for factor in factors), strict=True)
        return tuple(
            JointKind(tuple(None if node is None else held[node] for node in pair), *more)
            for pair, *more in zip(
                model.topology.joints,
                *masks,
                shifts,
                tuples_of(joints.parts),
                balls,
                kept,
                laws,
                strict=True,
            )
        )

    @staticmethod
    def values(model: Model, t: Tensor, inputs: Inputs, end: Later) -> Fields:
        if not model.joints.count:
            return {}
        values = model.joints.values(model.scene, t, inputs, end())
        given = {} if values is None else values._asdict()
        return {f"joint {name}": x for name, x in given.items() if x is not None}

    @staticmethod
    def constants(model: Model, values: Fields) -> JointConstants | None:
        joints = model.joints
        if not joints.count:
            return None
        laws = getattr(joints, "laws", None)
        given = (values.get(f"joint {name}") for name in JointValues._fields)
        return JointConstants(
            joints.v, joints.w, joints.c, joints.across, laws, *given, joints.balls,
            getattr(joints, "own_laws", None),
        )  # fmt: skip

    @staticmethod
    def fields(model: Model) -> dict[str, tuple[int, ...]]:
        return {"joints": (_numbers_of(model),)} | dict.fromkeys(FORCES, (model.space.unknowns,))

    def balance(self, kind: JointKind, **fields: Tensor) -> Fields:
        """What a joint gives the nodes at its ends and its own row: its push (w) on their balances,
        by end; what its constraints are to change by (`right`, w); its blocks (w, w), see
        `sorts`, its own being 1 for forces that it has not; the largest gap and turn.
        """
        problem, x = self.problem(fields, kind)
        return of_ends(problem, x, problem.model.joints, kind.sides, OWN)

    def finish(self, kind: JointKind, **fields: Tensor) -> Fields:
        """The joint at the end of the step: its forces (w), what is read of it, the work done by
        what acts in it.
        """
        after = self._after(*self.problem(fields, kind))
        joints = pad(after.joints[0], (0, kind.kept - after.joints.shape[-1]))
        return {"force": after.stress[0], "joints": joints, "work": after.work}

    def kinetic_energies(self, kind: JointKind, **fields: Tensor) -> list[Tensor]:
        """Of its inertia, before the step and after it."""
        problem, x = self.problem(fields, kind)
        return [
            problem.model.joints.kinetic_energy(s.position, s.rotation, s.velocity, s.spin)
            for s in (problem.start, self._after(problem, x))
        ]

    @staticmethod
    def _after(problem: BalanceProblem, x: Any) -> State:
        """The state at the end of the step."""
        reaction = x.u.new_zeros(len(problem.support_motions.nodes), x.stress.shape[-1])
        return problem.finish(x, reaction)

    def solution(self, kind: JointKind, **fields: Tensor) -> Fields:
        """The unknown forces of a step (w), from those that have acted in it (`after_force`)."""
        force = fields.pop("after_force")
        if not any(kind.prescribed or ()):
            return {"force": force}
        problem, x = self.problem(fields | {"force": force}, kind)
        kinematics, *_ = problem.node_balance(problem.apply_supports(x))
        joints = problem.model.joints
        placed = problem.node_motion(kinematics).placed(joints.pose)
        return {"force": force + joints.held[0] * joints.driven(placed).effort[0]}

    def problem(self, fields: Fields, kind: JointKind) -> tuple[BalanceProblem, Any]:
        """The same of one joint and the nodes at its ends, which have no loads."""
        at = {side: k for k, side in enumerate(kind.sides)}
        pair = tuple(at.get(side) for side in SIDES[1])
        ends = self.problems.of_ends(fields, kind, Framework(1, (), len(at), (pair,)))
        values = ends.values | {"stress": fields["force"][None], "joints": fields["joints"][None]}
        if "last_force" in fields:
            values["last_stress"] = fields["last_force"][None]
        tree = self.problems.trees.between["joint"]
        constants = filled(tree, lambda k: fields[f"joint.{k}"][None])
        rows = replace(ends.rows, joints=self._alone(ends.rows, constants, kind))
        now = replace(ends.now, joints=JointValues(constants.effort, constants.coordinate))
        return self.problems.problem(rows, None, ends.common, values, now)

    def _alone(self, rows: Rows, constants: JointConstants, kind: JointKind) -> Joints:
        """The one joint between the nodes of rows."""
        joints, like = self.problems.model.joints, constants.c

        def known(k: int, factor: Factor) -> Factor:
            """With numbers where the kind has them: shifts, and zeros for parts that there are
            not.
            """
            parts = zip(*(row[k] for row in kind.parts), strict=True)
            matrices = factor.constant, *factor.fixed.unbind(-3)
            constant, *fixed = (
                _numbered(x, tuple(None if there else 0.0 for there in part))
                for x, part in zip(matrices, parts, strict=True)
            )
            shift = _numbered(factor.shift, kind.shifts[k])
            return replace(factor, constant=constant, shift=shift, fixed=torch.stack(fixed, -3))

        numbers = {
            name: like.new_tensor([getattr(kind, name)])
            for name in ("held", "angles", "travels", "second", "prescribed")
            if getattr(kind, name) is not None
        }
        numbers |= {} if constants.laws is None else {"laws": constants.laws}
        if constants.own_laws is not None:
            numbers["own_laws"] = constants.own_laws.alone(kind.own_laws)
        return replace(
            joints,
            space=rows.space,
            framework=rows.topology,
            v=known(0, constants.v),
            w=known(1, constants.w),
            c=constants.c,
            across=known(2, constants.across),
            moves=joints.moves.detach(),
            balls=replace(constants.balls, at=(0,)) if kind.ball else None,
            behind=0,
            **numbers,
        )


def _numbers_of(model: Model) -> int:
    """How many numbers a state has of a joint."""
    return READINGS + model.scene.joint_memory


def _numbered(x: Tensor, numbers: tuple[float | None, ...]) -> Tensor:
    """x (..., rows, n), in some rows a number."""
    rows = zip(x.unbind(-2), numbers, strict=True)
    return torch.stack([row if k is None else torch.full_like(row, k) for row, k in rows], -2)


def _shifts(shift: Tensor) -> list[tuple[float | None, ...]]:
    """Of the rows of all joints (..., J, m, 1): the number, where it is 0 or 1 in all samples."""
    values = shift.detach()[None, ..., 0].flatten(0, -3)
    number = ((values == 0) | (values == 1)) & (values == values[:1])
    return [
        tuple(value if same else None for value, same in zip(*row, strict=True))
        for row in zip(values[0].tolist(), number.all(0).tolist(), strict=True)
    ]


JOINT = Sort("joint", "joint", "joints", ("joint_state",), "own_edges", sides=SIDES[1],
             functions=JointFunctions, unknowns=True, celled=True, early=True,
             kept="joints")  # fmt: skip
