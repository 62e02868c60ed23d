"""Local functions of load stepping: what one node and one element do in an equilibrium, and the rules of a sample.

They are those of a step where nothing moves: `SteadyProblem` in the place of `MidpointProblem`. Unknowns of a node are its
position and rotation; the load factor is a field of the sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ...core.status import SUCCESS
from ...equations import load_steps
from ...equations.steady import Configuration, SteadyProblem, placed
from ...scene.prescribed_motion import moved
from .local_functions import LocalFunctions
from .local_problem import Fields, Given, LocalProblem, unbatched
from .node_kinds import ElementKind, EndKind

POSE = {"position": 3, "frame": 4, "displacement": 3, "turn": 3}  # fields of a support's node, and their sizes


class SteadyKind(NamedTuple):
    """As `NodeKind`; fixed: 1 where a support holds the node's freedoms, else 0, None = no support; displaced: whether that has
    a displacement and a turn.
    """

    acting: tuple[int, ...] = ()
    hinge: tuple[float, ...] | None = None
    fixed: tuple[float, ...] | None = None
    displaced: tuple[bool, bool] = (False, False)

    support = None  # nothing moves while the load rises
    end = EndKind()  # elements know nothing of their nodes' supports


@dataclass(frozen=True)
class LocalSteadyProblem(Given, SteadyProblem):
    """An equilibrium of one node, or of one element."""


@dataclass(frozen=True)
class SteadyFunctions(LocalFunctions):
    """Functions of nodes, of elements, of rows of the chain, of samples."""

    @property
    def state(self) -> tuple[str, ...]:
        """Loads with internal states have them where they come to rest."""
        return self.NODE

    def _steady(self, problem: LocalProblem, load_factor: Tensor) -> tuple[SteadyProblem, Configuration]:
        """What a step starts from, as an equilibrium."""
        start = problem.start
        x = Configuration(start.position, start.rotation, start.stress)
        return LocalSteadyProblem(problem.model, problem.t, problem.inputs, load_factor, given=problem.given,
                                  stiffness=problem.stiffness), x

    def node(self, kind: SteadyKind, load_factor: Tensor, **fields: Tensor) -> Fields:
        """Balance (w) of the node's loads, less its inertia in a frame that turns, its derivative D (w, w); the loads."""
        problem, x = self._steady(self.of_node(fields, kind)[0], load_factor)
        w = self.model.space.unknowns
        load = unbatched(problem.load(x) + x.position.new_zeros(w), 2)
        tangent, D = problem.load_tangent(x), x.position.new_zeros(1, w, w)
        D = D if tangent is None else D + tangent.diagonal
        return {"balance": -load.expand(1, w)[0], "D": D[0], "load": load.expand(1, w)[0]}

    def update(self, kind: SteadyKind, move: Tensor, **fields: Tensor) -> Fields:
        """Position and rotation after a move (w)."""
        problem, x = self._steady(self.of_node(fields, kind)[0], move.new_ones(()))
        after = problem.update(x, move[None], x.stress)
        return {"position": after.position[0], "rotation": after.rotation[0]}

    def place(self, kind: SteadyKind, load_factor: Tensor, **fields: Tensor) -> Fields:
        """Position and rotation of a support's node where it has to be; of the node undeformed `pose.position` and
        `pose.frame`, and by all of the load `pose.displacement` and `pose.turn`.
        """
        problem, x = self._steady(self.of_node(fields, kind)[0], load_factor)
        space, (slides, turns) = problem.model.space.of_nodes(0), kind.displaced
        still = fields["pose.position"], fields["pose.frame"]
        displacement, turn = fields["pose.displacement"] if slides else None, fields["pose.turn"] if turns else None
        pose = moved(*still, displacement, turn, load_factor)
        fixed = x.position.new_tensor(kind.fixed)
        position, rotation = placed(space, fixed, pose, x.position[0], x.rotation[0])
        rotation = x.rotation[0] if rotation is None else rotation
        if kind.hinge is not None:
            rotation = space.hinged(rotation, space.pose(*still)[1], fixed.new_tensor(kind.hinge))
        return {"position": position, "rotation": rotation}

    def cosine(self, before: Tensor, rotation: Tensor) -> Fields:
        """Of half the angle that a node has turned by."""
        space = self.model.space
        return {"cosine": space.cosine(space.multiply(space.inverse(before), rotation)).abs()}

    def turn(self, move: Tensor) -> Fields:
        """Angle by which a move (w) turns a node."""
        return {"turn": torch.linalg.vector_norm(move[self.model.space.position:])}

    def element(self, kind: ElementKind, load_factor: Tensor, **fields: Tensor) -> Fields:
        """See `LocalFunctions.element`."""
        problem, x = self._steady(self.of_element(fields, kind)[0], load_factor)
        element = problem.element_balance(x)
        tangent, inertia = problem.tangent(x, element.acting), problem.load(x)
        wrench = None if isinstance(inertia, float) else -inertia
        return self.of_nodes(problem.model, element, problem.eigenstrain, tangent, wrench)

    def terms(self, load: Tensor | None, inertia: Tensor | None) -> list[Tensor]:
        """Loads less all inertia, of which `inertia` is what neighbours share."""
        return [load if inertia is None else load - inertia]

    def pivot(self, block: Tensor) -> Fields:
        """Whether a pivot block of the elimination is not positive definite (1 or 0), by those of its own elimination."""
        block, least = block + block.mT, None
        while len(block):
            first = block[0, 0]
            least = first if least is None else torch.minimum(least, first)
            block = block[1:, 1:] - block[1:, :1] * block[:1, 1:] / first
        return {"indefinite": 1 - (least > 0).to(least)}

    # Rules of a sample

    def judge(self, whole: Tensor, force: Tensor, moment: Tensor, least_force: Tensor, least_moment: Tensor, **fields: Tensor
              ) -> Fields:
        """See `LocalFunctions.judge`; where it is all of the load, nothing is foreseen. The least: see `rounding_stress`."""
        force, moment = torch.maximum(force, least_force), torch.maximum(moment, least_moment)
        return super().judge(force, moment, **fields, foresee=whole == 0)

    def first_step(self, turn: Tensor) -> Fields:
        """See `load_steps`."""
        return {"step": load_steps.first_step(turn)}

    def shares(self, reached: Tensor, step: Tensor, last_status: Tensor) -> Fields:
        """See `load_steps`; over, done: of samples that are not on their way; whole: whether it is all of the load."""
        climbing, share = load_steps.shares(reached, step, last_status)
        resting = (~climbing).to(share)
        return {"climbing": climbing.to(share), "load_factor": share, "over": resting, "done": resting,
                "whole": (share >= 1).to(share)}

    def advanced(self, climbing: Tensor, load_factor: Tensor, reached: Tensor, step: Tensor, last_status: Tensor, done: Tensor,
                 status: Tensor, cosine: Tensor, iterations: Tensor) -> Fields:
        """See `load_steps`; status: of the samples for which Newton's method is not done."""
        found = torch.where(done != 0, float(SUCCESS), status)
        good, reached, step, status = load_steps.advanced(climbing != 0, load_factor, reached, step, last_status, found, cosine,
                                                          iterations)
        return {"good": good.to(step), "reached": reached, "step": step, "last_status": status}
