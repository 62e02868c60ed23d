"""Tendons in native code: constants, kinds and local functions, stretch by stretch; a stretch's two
ends are called i and j, as those of an element; of the ground there are no fields.

With the tension known, a stretch pulls its two nodes together, as a tendon of two eyelets does. The
tensions follow from all stretches of the tendon, see `rope`, so that balances of its nodes depend
on each other. In the matrix each stretch has unknowns of its own, by which all that is coupled lies
side by side: the changes dT of its tension, dS of the length from it to the last eyelet, and dA of
what its turning adds at its end,

    dT_k = ratio dT_{k-1} + T_k (dA_{k-1} + by_q . dq_k) + slope dS_k
    dS_k = dS_{k+1} + e . dq_k
    dA_k = turned . dq_k                 dq: of the stretch's vector by the moves of its nodes

Of the first stretch ratio and by_q are 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ...core.leaves import Tree, leaf
from ...nodal.between_nodes import Placed
from ...nodal.joint_motion import end_moves
from ...nodal.model import Model
from ...nodal.rope import Rope, Stretches, along_stretch
from ...nodal.tendons import Tendons, mean_tension
from ...scene.effects import Inputs
from ...topology.framework import Framework
from .chain_constants import filled
from .interaction_functions import InteractionFunctions, Later, Several, pushed
from .layout import STRETCHES
from .local_problem import Fields
from .row_kinds import EndKind, sides_of
from .sorts import SIDES, Edge, Edges, Sort

# what a tension follows from, of all stretches from one on
SUMMED = "length", "before", "change", "rate"


@dataclass(frozen=True)
class StretchConstants(Tree):
    """Rows of stretches, see `Rope` and `Tendons`: arms of both ends; given (..., S, 1 or 2): see
    `Tendons.values`; the law's numbers, 0 where others have one, None = none has.
    """

    arms: Tensor = leaf(3)
    drawn: Tensor = leaf(1)
    given: Tensor = leaf(2)
    stiffness: Tensor | None = leaf(1)
    friction: Tensor | None = leaf(1)
    slip_speed: Tensor | None = leaf(1)


class StretchKind(NamedTuple):
    """What code of a stretch of a tendon depends on: what holds its two ends, None = it is the
    ground; whether the tendon has a stiffness, and friction.
    """

    ends: tuple[EndKind | None, EndKind | None]
    elastic: bool
    has_friction: bool
    multiplied: ClassVar[bool] = False
    kept: ClassVar[int] = 0
    told: ClassVar[int] = 0

    sides = property(lambda self: sides_of(self.ends))

    @property
    def coupled(self) -> bool:
        """Whether its tension depends on where the other stretches are."""
        return self.elastic or self.has_friction

    def by_word(self) -> dict[str, tuple[Any, ...]]:
        """What each of its functions depends on, by the first word of their names."""
        return {
            "stretch": (self.ends, self.coupled, self.has_friction),
            "tension": (self.elastic, self.has_friction),
            "tie": (self.ends, self.coupled),
        }


@dataclass(frozen=True)
class TendonFunctions(InteractionFunctions):
    """Functions of a stretch."""

    @staticmethod
    def edges(model: Model) -> Edges:
        edges, tendons = [], model.tendons
        pairs = tendons.stretches
        for s, (k, e) in enumerate(pairs):
            first, last = s == 0 or pairs[s - 1][0] < k, s + 1 == len(pairs) or pairs[s + 1][0] > k
            rope, more = tendons.ropes[k], (int(first), int(last), k)
            alone = rope.stiffness is not None or rope.friction is not None
            nodes = tendons.nodes[e : e + 2]
            edges.append(Edge(nodes, None, False, alone, alone and not first, more))
        return tuple(edges)

    @staticmethod
    def kinds(model: Model, held: list[EndKind], several: Several) -> tuple[StretchKind, ...]:
        tendons = model.tendons
        if not tendons.stretches:
            return ()
        ends = [None if node is None else held[node] for node in tendons.nodes]
        ropes = [(x.stiffness is not None, x.friction is not None) for x in tendons.ropes]
        return tuple(StretchKind((ends[e], ends[e + 1]), *ropes[k]) for k, e in tendons.stretches)

    @staticmethod
    def values(model: Model, t: Tensor, inputs: Inputs, end: Later) -> Fields:
        if not model.tendons.stretches:
            return {}
        drives = model.tendons.values(model.scene, t, inputs, end())
        return {"tendon given": drives[..., [k for k, _ in model.tendons.stretches], :]}

    @staticmethod
    def constants(model: Model, values: Fields) -> StretchConstants | None:
        tendons = model.tendons
        if not tendons.stretches:
            return None
        rope_of, first = zip(*tendons.stretches, strict=True)

        def of_ropes(name: str) -> Tensor | None:
            of_each = [getattr(rope, name) for rope in tendons.ropes]
            like = next((x for x in of_each if x is not None), None)
            if like is None:
                return None
            rows = (torch.zeros_like(like) if x is None else x for x in of_each)
            return torch.stack(torch.broadcast_tensors(*rows), -1)[..., list(rope_of)]

        ends = (tendons.arms[..., [e + k for e in first], :] for k in range(2))
        drawn, *ropes = map(of_ropes, ("drawn", "stiffness", "friction", "slip_speed"))
        return StretchConstants(torch.stack([*ends], -2), drawn, values["tendon given"], *ropes)

    @staticmethod
    def fields(model: Model) -> dict[str, tuple[int, ...]]:
        own = {"length": (), "direction": (3,)}
        return {
            **{"tension": (), "slope": (), "ratio": (), "by_q": (3,), "turned": (3,)},
            **own,
            **{f"beyond.{name}": () for name in SUMMED},
            **{f"last.{name}": shape for name, shape in (own | {"tension": ()}).items()},
            **{f"own.{name}": shape for name, shape in own.items()},
            "change": (),
            "start": (),
        }

    def stretch(self, kind: StretchKind, **fields: Tensor) -> Fields:
        """Its length after the step, and where forces act at its start, before; by how much it has
        become longer; its direction (3) after; with friction the rate at which it did before.
        """
        problem, x = self.problem(fields, kind)
        motion = problem.node_motion(problem.node_balance(problem.apply_supports(x))[0])
        tendons = problem.model.tendons
        motion = motion.placed(tendons.eyelets)
        (step,) = tendons.steps(motion, motion.of.now.tendons)
        stretches = Stretches.of(step)
        before, after = (length[0] for length in stretches.lengths)
        outputs = {"length": after, "before": before, "direction": stretches.directions[1][0]}
        if kind.has_friction and self.problems.OVER_STEP:
            outputs["rate"] = (stretches.directions[0] * step.rates.diff(dim=-2)).sum()
        if kind.coupled and self.problems.OVER_STEP:
            outputs["change"] = stretches.change(step._replace(way=tendons.way(motion)))[0]
        elif motion.start is not None:
            outputs["change"] = after - tendons.lengths_before(motion, 0)[0]
        return outputs

    def tension_first(self, kind: StretchKind, **fields: Tensor) -> Fields:
        """Tension of the first stretch, from the sums over all, and its derivative by the
        length.
        """
        constants = self._constants(fields)
        rope, before, change = self._rope(constants, kind), None, None
        drive = rope.raised(constants.given, fields.get("load_factor"))
        if self.problems.OVER_STEP:
            before = fields["beyond.before"]
            change = fields["beyond.change"] if kind.elastic else None
        T, slope = rope.pull(drive, fields["beyond.length"], before, change)
        return {"tension": T, "slope": slope}

    def tension_next(self, kind: StretchKind, **fields: Tensor) -> Fields:
        """Tension of a stretch from that of the one `last.`, by the friction between them; see
        above; `turned` is of the last one; `told`, where it is given: see `Grip`.
        """
        last, none = fields["last.tension"], torch.zeros_like(fields["own.direction"])
        if not kind.has_friction:
            one = torch.ones_like(last)
            return {"tension": last, "slope": 0 * one, "ratio": one, "by_q": none, "turned": none}
        rope = self._rope(self._constants(fields), kind)
        slide = None
        if self.problems.OVER_STEP:
            sums = (fields[f"beyond.{name}"][None] for name in ("change", "rate"))
            slide = *sums, self.problems.common_of(fields).dt
        ends = fields["last.direction"], fields["own.direction"]
        told = fields["told"][None] if "told" in fields else None
        grip = rope.grip(ends[0][None], ends[1][None], slide, told)
        ratio, turn = torch.exp(grip.log[0]), grip.turn[0]
        T = ratio * last
        return {
            "tension": T,
            "slope": 0 * T if grip.slide is None else T * grip.slide[0],
            "ratio": ratio,
            "by_q": along_stretch(-turn, ends[1], fields["own.length"][None]),
            "turned": along_stretch(turn, ends[0], fields["last.length"][None]),
        } | ({} if told is None or grip.told is None else {"told": grip.told[0]})

    def balance(self, kind: StretchKind, **fields: Tensor) -> Fields:
        """What a stretch gives its nodes, see `JointFunctions.balance`: its push (w) by end, blocks
        (w, w); where other stretches matter (`coupled`) those of its own unknowns, too, and with
        those of the one before.
        """
        if not kind.sides:  # between points of the ground
            return self._own_blocks(fields) if kind.coupled else {}
        problem, x = self.problem(fields, kind)
        kinematics, inertia, _ = problem.node_balance(problem.apply_supports(x))
        nodes, _ = problem.node_tangent(kinematics, inertia)
        motion = problem.node_motion(kinematics, nodes)._replace(share=None)  # its tension has it
        tendons, T = problem.model.tendons, fields["tension"]
        placed, w, n = (
            motion.placed(tendons.eyelets),
            self.problems.model.space.unknowns,
            len(kind.sides),
        )
        unit = tendons.loaded(T.new_zeros(n, w), placed, T.new_ones(1, 1))
        blocks = tendons.blocks(placed, T[None, None]).unflatten(0, (n, n))
        outputs = pushed(T * unit, kind.sides, blocks)
        if kind.coupled:
            outputs |= self._own_blocks(fields)
            rows = self._own_rows(tendons, placed, fields)
            outputs |= {f"o{side}": rows[side] for side in kind.sides}
            columns = zip(kind.sides, unit, strict=True)
            outputs |= {f"{side}o": pad(x[:, None], (0, w - 1)) for side, x in columns}
        return outputs

    def _own_blocks(self, fields: Fields) -> Fields:
        """Of dT, dS, dA by themselves, by those of the stretch before, and of dS there."""
        w, T = self.problems.model.space.unknowns, fields["tension"]
        entries = {
            "oo": {(0, 1): -fields["slope"]},
            "op": {(0, 0): -fields["ratio"], (0, 2): -T},
            "po": {(1, 1): -torch.ones_like(T)},
        }
        blocks = {}
        for name, there in entries.items():
            rows = [[there.get((i, j), torch.zeros_like(T)) for j in range(w)] for i in range(w)]
            blocks[name] = torch.stack([torch.stack(row) for row in rows])
        blocks["oo"] = blocks["oo"] + torch.eye(w, dtype=T.dtype)
        return blocks

    def _own_rows(self, tendons: Tendons, motion: Placed, fields: Fields) -> Fields:
        """Of dT, dS, dA by the moves of the ends (w, w), by side."""
        by = torch.stack(
            (fields["tension"] * fields["by_q"], fields["direction"], fields["turned"])
        )
        half, by_side = motion.of.half_turns(), {}
        nodes = [node for node in tendons.nodes if node is not None]
        for end, sign in ((0, 1.0), (1, -1.0)):
            if tendons.nodes[end] is None:
                continue
            lever = motion.end.lever[end].expand(3, 3)
            rows = sign * motion.of.rate * tendons.wrench(lever, by)
            if half is not None:
                k = nodes.index(tendons.nodes[end])
                rows = rows @ end_moves(half[k], self.problems.model.space.dims.position)
            w = rows.shape[-1]
            by_side[SIDES[1][end]] = torch.cat((rows, rows.new_zeros(w - 3, w)))
        return by_side

    def finish(self, kind: StretchKind, **fields: Tensor) -> Fields:
        """Work of a stretch over the step; start: tension at its start, see `Tendons.finished`."""
        start = None if self.problems.OVER_STEP else fields["start"]
        return {"work": -mean_tension(fields["tension"], start) * fields["change"]}

    def problem(self, fields: Fields, kind: StretchKind) -> tuple[Any, Any]:
        """The problem of one stretch, a tendon of two eyelets, and the nodes at its ends, which
        have no loads.
        """
        n = len(kind.sides)
        some = kind if n else kind._replace(ends=(EndKind(), None))  # a problem has a node
        nodes = len(some.sides)
        ends = self.problems.of_ends(fields, some, Framework(1, (), nodes, (), (tuple(range(n)),)))
        constants, tendons = self._constants(fields), self.problems.model.tendons
        numbers = iter(range(n))
        nodes = tuple(None if end is None else next(numbers) for end in kind.ends)
        rope = Rope(constants.drawn, None, constants.friction if kind.has_friction else None)
        tendons = replace(
            tendons,
            space=ends.rows.space,
            framework=ends.rows.topology,
            ropes=(rope,),
            sizes=(2,),
            nodes=nodes,
            arms=constants.arms,
            moves=tendons.moves.detach(),
        )
        rows = replace(ends.rows, tendons=tendons)
        now = replace(ends.now, tendons=constants.given[None])
        return self.problems.problem(rows, None, ends.common, ends.values, now)

    def _constants(self, fields: Fields) -> StretchConstants:
        """Of one stretch."""
        return filled(self.problems.trees.between["stretch"], lambda k: fields[f"stretch.{k}"])

    def _rope(self, constants: Any, kind: StretchKind) -> Rope:
        return Rope(
            constants.drawn,
            constants.stiffness if kind.elastic else None,
            constants.friction if kind.has_friction else None,
            constants.slip_speed if kind.has_friction else None,
        )


TIE = Sort("tie", "stretch", STRETCHES, ("pull", "told stretches", "at_stretch"), sides=SIDES[1],
           functions=TendonFunctions, unknowns=True, chained=True, more=3,
           of="tendons")  # fmt: skip
