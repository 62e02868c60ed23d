"""Local functions of a generalized-alpha step: those of the midpoint step, of this problem.

A node's state has its accelerations as well, and an element's, where strains are damped, their
rates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from ...equations.generalized_alpha import AlphaState, EndUnknowns, GeneralizedAlphaProblem
from ...nodal.conditions import Conditions
from ...nodal.rows import Rows
from ...state.state import State
from .chain_constants import Common
from .local_functions import LocalFunctions
from .local_problem import NODE, Fields
from .row_kinds import ElementKind, NodeKind

STRAINING = "straining"


@dataclass(frozen=True)
class AlphaFunctions(LocalFunctions):
    """Functions of nodes, of elements and of what acts between nodes; those of the adjoint."""

    rho_inf: float = 0.8

    NODE = (*NODE, "acceleration")
    UNKNOWNS = EndUnknowns
    OVER_STEP = False
    INSTANT = GeneralizedAlphaProblem.INSTANT

    @property
    def options(self) -> tuple[Any, ...]:
        return (self.rho_inf,)

    @property
    def element_state(self) -> tuple[str, ...]:
        return (STRAINING,) if self.trees.element.rows.law.damped else ()

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

    def _stepping(
        self,
        rows: Rows,
        start: State,
        common: Common,
        values: Fields,
        now: Conditions,
        C: Tensor | None,
    ) -> GeneralizedAlphaProblem:
        stations = rows.topology.element_count * self.order
        straining = values.get(
            STRAINING, start.position.new_zeros(stations, 2 * rows.space.dims.strain)
        )
        start = AlphaState(**vars(start), acceleration=values["acceleration"], straining=straining)
        return GeneralizedAlphaProblem(
            rows,
            start,
            common.dt,
            common.t,
            common.inputs,
            rho_inf=self.rho_inf,
            known=now,
            stiffness=C,
        )

    def finish_element(self, kind: Any, **fields: Tensor) -> Fields:
        """The element's state at the end of the step."""
        problem, x = self.of_element(fields, kind)
        x = problem.apply_supports(x)
        return {STRAINING: problem.straining(problem.motion.kinematics(x.u, x.m))}

    def solution(self, **fields: Tensor) -> Fields:
        displacement, turn = self.moved(fields)
        return {"u": displacement, "m": turn}
