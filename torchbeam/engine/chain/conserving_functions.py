"""Local functions of a midpoint step that closes the energy balance: with the energies of a node
and of an element.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from ...equations.energy_projection import kinetic_rise, projected, strain_rise
from ...equations.midpoint import MidpointProblem
from ...state.state import State
from .local_functions import LocalFunctions
from .local_problem import Fields
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
        return ENERGIES

    def energies(self, problem: MidpointProblem, after: State) -> Fields:
        kinetic, rise = kinetic_rise(problem.model, problem.start, after)
        return {"kinetic": kinetic, "rise": rise - after.work}

    def finish_element(self, kind: Any, **fields: Tensor) -> Fields:
        """Energies that are the element's own: those of strains, and of what its nodes share."""
        problem, x = self.of_element(fields, kind)
        after = problem.finish(x, x.u.new_zeros(0, self.model.space.unknowns))
        kinetic, rise = kinetic_rise(problem.model, problem.start, after)
        strain = strain_rise(problem.model, problem.start, after, problem.dt, problem.eigenstrain)
        return {"kinetic": kinetic, "rise": rise + strain}

    def finished(self, sort: Sort, kind: Any, **fields: Tensor) -> Fields:
        """With what the work makes the energy rise by less, of what is neither node nor element."""
        outputs = super().finished(sort, kind, **fields)
        return outputs if sort in (NODE, ELEMENT) else outputs | {"rise": -outputs["work"]}

    def project(self, defect: Tensor, kinetic: Tensor, rise: Tensor) -> Fields:
        """See `energy_projection`; of all nodes and elements together."""
        scale, defect = projected(defect + rise, kinetic)
        return {"scale": scale, "defect": defect}

    def scaled(self, velocity: Tensor, spin: Tensor, scale: Tensor) -> Fields:
        """Velocity and spin of a node."""
        return {"velocity": scale * velocity, "spin": scale * spin}
