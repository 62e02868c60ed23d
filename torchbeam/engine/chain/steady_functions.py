"""Local functions of load stepping: what one node and one element do in an equilibrium, and the
rules of a sample.

They are those of a step where nothing moves: `SteadyProblem` in the place of `MidpointProblem`.
Unknowns of a node are its position and rotation; the load factor is a field of the sample.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from ...core.status import DIVERGED, SUCCESS
from ...equations import load_steps
from ...equations.steady import Configuration, SteadyProblem, placed
from ...nodal.conditions import Conditions
from ...nodal.rows import Rows
from ...scene.prescribed_motion import moved
from .chain_constants import Common
from .local_functions import LocalFunctions
from .local_problem import Fields
from .row_kinds import NodeKind
from .sample_functions import SampleFunctions

# fields of a support's node, and their sizes
POSE = {"position": 3, "rotation": 4, "displacement": 3, "turn": 3}


@dataclass(frozen=True)
class SteadyFunctions(LocalFunctions):
    """Functions of nodes, of elements and of what acts between nodes; resisting: see
    `SteadyProblem`.
    """

    resisting: bool = field(default=False, kw_only=True)

    SAMPLE = ("load_factor",)
    OVER_STEP = False
    searches = False

    @property
    def state(self) -> tuple[str, ...]:
        """Loads with internal states have them where they come to rest."""
        return self.NODE

    @property
    def loaded(self) -> bool:
        return True  # of which inertia is a part

    def _solved(
        self, rows: Rows, common: Common, values: Fields, now: Conditions, C: Tensor | None
    ) -> tuple[SteadyProblem, Configuration]:
        x = Configuration(values["position"], values["rotation"], values["stress"])
        load_factor = values.get("load_factor", common.t.new_ones(()))  # a move asks for none
        of = rows, common.t, common.inputs, load_factor
        return SteadyProblem(*of, known=now, stiffness=C, resisting=self.resisting), x

    def place(self, kind: NodeKind, load_factor: Tensor, **fields: Tensor) -> Fields:
        """Position and rotation of a support's node where it has to be; of the node undeformed
        `pose.position` and `pose.rotation`, and by all of the load `pose.displacement` and
        `pose.turn`.
        """
        problem, x = self.of_node(fields, kind)
        space, (slides, turns) = problem.model.space.of_nodes(0), kind.placed.displaced
        still = fields["pose.position"], fields["pose.rotation"]
        displacement = fields["pose.displacement"] if slides else None
        turn = fields["pose.turn"] if turns else None
        pose = moved(*still, displacement, turn, load_factor)
        fixed = x.position.new_tensor(kind.placed.fixed)
        position, rotation = placed(space, fixed, pose, x.position[0], x.rotation[0])
        rotation = x.rotation[0] if rotation is None else rotation
        if kind.placed.hinge is not None:
            rotation = space.hinged(
                rotation, space.pose(*still)[1], fixed.new_tensor(kind.placed.hinge)
            )
        return {"position": position, "rotation": rotation}

    def cosine(self, before: Tensor, rotation: Tensor) -> Fields:
        """Of half the angle that a node has turned by."""
        space = self.model.space
        return {"cosine": space.cosine(space.multiply(space.inverse(before), rotation)).abs()}

    def turn(self, move: Tensor, rotation: Tensor | None = None, **pose: Tensor) -> Fields:
        """Angle by which a move (w) turns a node, or its support does, where that turns some."""
        turn = torch.linalg.vector_norm(move[self.model.space.dims.position :])
        if rotation is None:
            return {"turn": turn}
        still, by, space = pose["pose.rotation"], pose["pose.turn"], self.model.space.of_nodes(0)
        led = load_steps.way_of_support(space, rotation, still, by)
        led = torch.where((by != 0).any(-1), led, torch.zeros_like(led))
        return {"turn": load_steps.with_supports(turn, led)}

    def terms(self, load: Tensor | None, inertia: Tensor | None) -> list[Tensor]:
        """Loads less all inertia, of which `inertia` is what neighbours share."""
        return [load if inertia is None else load - inertia]

    def pivot(self, block: Tensor) -> Fields:
        """Whether a pivot block of the elimination is not positive definite (1 or 0), by those of
        its own elimination.
        """
        block, least = block + block.mT, None
        while len(block):
            first = block[0, 0]
            least = first if least is None else torch.minimum(least, first)
            block = block[1:, 1:] - block[1:, :1] * block[:1, 1:] / first
        return {"indefinite": 1 - (least > 0).to(least)}

    @property
    def samples(self) -> LoadSamples:
        return LoadSamples(self.model)


@dataclass(frozen=True)
class LoadSamples(SampleFunctions):
    """Functions of a sample whose load rises."""

    def judge(
        self,
        whole: Tensor,
        force: Tensor,
        moment: Tensor,
        least_force: Tensor,
        least_moment: Tensor,
        **fields: Tensor,
    ) -> Fields:
        """See `SampleFunctions.judge`; where it is all of the load, nothing is foreseen. The least:
        see `least_forces`.
        """
        force, moment = torch.maximum(force, least_force), torch.maximum(moment, least_moment)
        return super().judge(**fields, force=force, moment=moment, foresee=whole == 0)

    def first_step(self, turn: Tensor, smallest: Tensor) -> Fields:
        """See `load_steps`; a sample that would begin with less than the smallest has failed."""
        step = load_steps.first_step(turn)
        return {"step": step, "last_status": torch.where(step < smallest, float(DIVERGED), 0.0)}

    def shares(self, reached: Tensor, step: Tensor, last_status: Tensor) -> Fields:
        """See `load_steps`; over, done: of samples that are not on their way; whole: whether it is
        all of the load.
        """
        climbing, share = load_steps.shares(reached, step, last_status)
        resting = (~climbing).to(share)
        return {
            "climbing": climbing.to(share),
            "load_factor": share,
            "over": resting,
            "done": resting,
            "whole": (share >= 1).to(share),
        }

    def advanced(
        self,
        climbing: Tensor,
        load_factor: Tensor,
        reached: Tensor,
        step: Tensor,
        last_status: Tensor,
        done: Tensor,
        status: Tensor,
        cosine: Tensor,
        iterations: Tensor,
        smallest: Tensor,
    ) -> Fields:
        """See `load_steps`; status: of the samples for which Newton's method is not done."""
        status_after = torch.where(done != 0, float(SUCCESS), status)
        of_step = status_after, cosine, iterations, smallest
        good, reached, step, status = load_steps.advanced(
            climbing != 0, load_factor, reached, step, last_status, *of_step
        )
        return {"good": good.to(step), "reached": reached, "step": step, "last_status": status}
