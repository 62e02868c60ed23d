"""Local functions of methods beside the midpoint step.

`ConservingFunctions` are of one that closes the energy balance: with the energies of a node and of
an element. `AlphaFunctions` are of generalized alpha: a node's state has its accelerations as well,
and an element's, where strains are damped, their rates. `ExtrapolatedFunctions` are of a step that
is a mean of two: of one midpoint step, and of several in a row that start where it does.

Each solve of these takes a node's state X to an end E; beside X a node remembers another end Y.
After it, with the numbers a, e, y, k of the solve (`mixtures`), in all of X that has a mean,

    X <- a X + e E + y Y        Y <- k E + (1 - k) Y

so that the first solve keeps the whole step's end and goes back to the start, those in between go
on, and the last leaves the weighted mean, a unit quaternion made such again, and its own end, by
which the adjoint knows how it moved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from ...equations.energy_projection import kinetic_rise, projected, strain_rise
from ...equations.generalized_alpha import AlphaState, EndUnknowns, GeneralizedAlphaProblem
from ...equations.midpoint import MidpointProblem
from ...nodal.rows import Rows
from ...state.state import State
from .joint_functions import JOINT
from .local_functions import LocalFunctions
from .local_problem import NODE as STATE
from .local_problem import Fields
from .row_kinds import ElementKind, NodeKind
from .sorts import ELEMENT, NODE, Sort

ENERGIES = ("kinetic", "rise")


@dataclass(frozen=True)
class ConservingFunctions(LocalFunctions):
    """Functions of nodes, of elements and of what acts between nodes. kinetic: energy at the end
    of the step; rise: of kinetic and strain energy, with what damping takes and less the work of
    the loads.
    """

    @property
    def sample_state(self) -> tuple[str, ...]:
        return (*super().sample_state, "defect")

    @property
    def element_ends(self) -> tuple[str, ...]:
        return (*super().element_ends, *ENERGIES)

    def energies(self, problem: MidpointProblem, after: State) -> Fields:
        kinetic, rise = kinetic_rise(problem.model, problem.start, after)
        return {"kinetic": kinetic, "rise": rise - after.work}

    def finish_element(self, kind: Any, **fields: Tensor) -> Fields:
        """Energies that are the element's own: those of strains, and of what its nodes share."""
        problem, x = self.of_element(fields, kind)
        after = problem.finish(x, x.u.new_zeros(0, self.model.space.unknowns))
        kinetic, rise = kinetic_rise(problem.model, problem.start, after)
        strain = strain_rise(problem.model, problem.start, after, problem.dt, problem.eigenstrain)
        ends = super().finish_element(kind, **fields)
        return ends | {"kinetic": kinetic, "rise": rise + strain}

    def finished(self, sort: Sort, kind: Any, **fields: Tensor) -> Fields:
        """With what the work makes the energy rise by less, of what is neither node nor element."""
        outputs = super().finished(sort, kind, **fields)
        if sort in (NODE, ELEMENT):
            return outputs
        if sort is not JOINT or self.model.joints.inertia is None:
            return outputs | {"rise": -outputs["work"]}
        before, kinetic = self.of(sort).kinetic_energies(kind, **fields)
        return outputs | {"kinetic": kinetic, "rise": kinetic - before - outputs["work"]}

    def project(self, defect: Tensor, kinetic: Tensor, rise: Tensor) -> Fields:
        """See `energy_projection`; of all nodes and elements together."""
        scale, defect = projected(defect + rise, kinetic)
        return {"scale": scale, "defect": defect}

    def scaled(self, velocity: Tensor, spin: Tensor, scale: Tensor) -> Fields:
        """Velocity and spin of a node."""
        return {"velocity": scale * velocity, "spin": scale * spin}


STRAINING = "straining"


@dataclass(frozen=True)
class AlphaFunctions(LocalFunctions):
    """Functions of nodes, of elements and of what acts between nodes; those of the adjoint."""

    rho_inf: float = 0.8

    NODE = (*STATE, "acceleration")
    UNKNOWNS = EndUnknowns
    OVER_STEP = False
    INSTANT = GeneralizedAlphaProblem.INSTANT

    @property
    def options(self) -> tuple[Any, ...]:
        return (self.rho_inf,)

    @property
    def element_state(self) -> tuple[str, ...]:
        straining = (STRAINING,) if self.trees.element.rows.law.damped else ()
        return (*super().element_state, *straining)

    def of_node(
        self, fields: Fields, kind: NodeKind
    ) -> tuple[GeneralizedAlphaProblem, EndUnknowns]:
        problem, x = super().of_node(fields, kind)
        if kind.support is not None and "last" in fields:
            problem = replace(problem, start=replace(problem.start, reaction=fields["last"][None]))
        common = self.common_of(fields)
        if common.before is None:
            return problem, x
        before = self.conditions(
            problem.model, kind, self._of_node(fields).before, common, common.before, None, ()
        )
        return replace(problem, before=before), x

    def of_element(
        self, fields: Fields, kind: ElementKind, between: bool = False
    ) -> tuple[GeneralizedAlphaProblem, EndUnknowns]:
        problem, x = super().of_element(fields, kind, between)
        common = self.common_of(fields)
        if not between or common.before is None:
            return problem, x
        before = self.conditions(problem.model, None, None, common, common.before, None, ())
        before = self._with_between(problem.model, before, common.before, kind)
        return replace(problem, before=before), x

    def _over(
        self, rows: Rows, start: State, values: Fields, *step: Any, **known: Any
    ) -> GeneralizedAlphaProblem:
        stations = rows.topology.element_count * self.order
        straining = values.get(
            STRAINING, start.position.new_zeros(stations, 2 * rows.space.dims.strain)
        )
        start = AlphaState(**vars(start), acceleration=values["acceleration"], straining=straining)
        return GeneralizedAlphaProblem(rows, start, *step, rho_inf=self.rho_inf, **known)

    def finish_element(self, kind: Any, **fields: Tensor) -> Fields:
        """The element's state at the end of the step."""
        ends = super().finish_element(kind, **fields)
        if STRAINING not in self.element_state:
            return ends
        problem, x = self.of_element(fields, kind)
        x = problem.apply_supports(x)
        return ends | {STRAINING: problem.straining(problem.motion.kinematics(x.u, x.m))}

    def solution(self, **fields: Tensor) -> Fields:
        displacement, turn = self.moved(fields)
        return {"u": displacement, "m": turn}


OTHER = "other_"  # before the name of a node's field


def mixtures(parts: int, weights: tuple[float, float]) -> list[tuple[float, ...]]:
    """a, e, y, k of the solves of a step: of the whole, whose weight comes first, and of so many
    parts in a row.
    """
    of_whole, of_parts = weights
    between, last = (0.0, 1.0, 0.0, 0.0), (0.0, of_parts, of_whole, 1.0)
    return [(1.0, 0.0, 0.0, 1.0), *[between] * (parts - 1), last]


@dataclass(frozen=True)
class ExtrapolatedFunctions(LocalFunctions):
    """Functions of nodes, of elements and of what acts between nodes; those of the adjoint."""

    @property
    def state(self) -> tuple[str, ...]:
        fields = super().state
        return (*fields, *(f"{OTHER}{name}" for name in fields))

    @property
    def element_state(self) -> tuple[str, ...]:
        fields = super().element_state
        return (*fields, *(f"{OTHER}{name}" for name in fields))

    def finish_node(self, kind: NodeKind, **fields: Tensor) -> Fields:
        """See `LocalFunctions.finish_node`, with the means above."""
        after = self._mixed(super().finish_node(kind, **fields), super().state, fields)
        after["rotation"] = self.model.space.normalize(after["rotation"])
        return after

    def finish_element(self, kind: Any, **fields: Tensor) -> Fields:
        ends = super().finish_element(kind, **fields)
        return self._mixed(ends, super().element_state, fields) if ends else ends

    def _mixed(self, ends: Fields, names: tuple[str, ...], fields: Fields) -> Fields:
        """Ends with the means above."""
        a, e, y, k = self.common_of(fields).mixture.unbind(-1)
        after = dict(ends)
        for name in names:
            start, end, other = fields[name], ends[name], fields[f"{OTHER}{name}"]
            after[name] = a * start + e * end + y * other
            after[f"{OTHER}{name}"] = k * end + (1 - k) * other
        return after

    def end(self, fields: Fields) -> tuple[Tensor, Tensor]:
        """Where the end is remembered, by it."""
        k = self.common_of(fields).mixture[3]
        position, rotation = (
            k * fields[f"after_{OTHER}{name}"] + (1 - k) * fields[f"after_{name}"]
            for name in ("position", "rotation")
        )
        return position, rotation
