"""What is solved: the balance of nodes and the law of elements, at rest or over a step."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..core.leaves import Tree, leaf
from ..nodal import element_loads
from ..nodal.balance import (
    CondensedTangent,
    Linearisation,
    Residual,
    largest,
    restrained_forces,
    size_of_strain,
)
from ..nodal.between_nodes import NodeMotion, Told
from ..nodal.conditions import Conditions
from ..nodal.frame import FixedFrame
from ..nodal.inertia import InertiaForces
from ..nodal.loads import MotionJacobian, Nodes
from ..nodal.rows import Rows
from ..topology.protocols import Matrix
from .step_element import BalancedElement, ElementBalance


@dataclass(frozen=True)
class BalanceProblem(Tree):
    """inertia + to_nodes(h B^T [F; M]) - load = 0 at the nodes, gap = 0 in the elements, of rows
    under `conditions`.

    A subclass says what its unknowns x are, a named tuple of two tensors of nodes and of the
    `stress` (`apply_supports`, `update`); how nodes move by them, and what that asks for
    (`node_balance`, `node_tangent`); and the elements between (`element`).

    known      conditions of rows; None = those of the model, which is a whole `Model` then
    stiffness  S^-1 of the tangent beside them; None = there are no elements
    """

    model: Rows
    known: Conditions | None = field(default=None, kw_only=True)
    stiffness: Tensor | None = leaf(3, default=None, kw_only=True)
    told: ClassVar[Told | None] = None  # by the last iteration

    @property
    def conditions(self) -> Conditions:
        """What acts and is prescribed, at the instant at which loads are taken."""
        raise NotImplementedError

    @property
    def C(self) -> Tensor:
        """S^-1 of the tangent."""
        raise NotImplementedError

    @property
    def frame(self) -> FixedFrame:
        """Frame a at that instant."""
        return self.conditions.frame

    @property
    def eigenstrain(self) -> Tensor | float:
        """What the beam bends by itself."""
        return self.conditions.eigenstrain

    @property
    def least(self) -> tuple[Tensor, ...]:
        """Terms, of elements or nodes, that the balance is measured against beside its own."""
        return ()

    @property
    def rounding(self) -> Tensor | float:
        """What floating point may leave of the balance (..., N+1, w), 0.0 = nothing."""
        return 0.0

    @property
    def element(self) -> BalancedElement:
        """The elements."""
        raise NotImplementedError

    def apply_supports(self, x: Any) -> Any:
        """x with the supports where they have to be."""
        raise NotImplementedError

    def update(self, x: Any, move: Tensor, dstress: Tensor) -> Any:
        """x after moves (..., N+1, w) and a change of the stress."""
        raise NotImplementedError

    def node_balance(self, x: Any) -> tuple[Any, InertiaForces | None, Tensor | float]:
        """Motion of the nodes, of which `poses` are those that elements ask for; what it asks of
        them, None = nothing; and loads (..., N+1, w), 0.0 = none. Each node's own, but for the mass
        that neighbours share.
        """
        raise NotImplementedError

    def node_tangent(
        self, kinematics: Any, inertia: InertiaForces | None
    ) -> tuple[Any, Matrix | None]:
        """Derivatives of the motion, and of inertia less loads, by nodes' moves; None = none."""
        raise NotImplementedError

    def element_loads(self, kinematics: Any) -> tuple[Tensor, ...] | None:
        """Loads between nodes, on each node of the elements (..., N, w); None = there are none."""
        now = self.conditions
        if not now.between:
            return None
        return element_loads.element_loads(self.model, self.nodes(kinematics), now)

    def element_load_matrix(self, kinematics: Any, nodes: Any = None) -> Matrix | None:
        """What they add to the tangent; None = nothing. nodes: the derivatives of the motion, where
        they are known.
        """
        now = self.conditions
        if not now.between:
            return None
        motion = self.node_motion(kinematics, nodes)
        at, by = motion.nodes(now.reads), motion.by(now.reads)
        return element_loads.element_matrix(self.model, at, now, by).each(torch.neg)

    def nodes(self, kinematics: Any, reads: frozenset[str] | None = None) -> Nodes:
        """What is seen by loads, or by what reads these."""
        raise NotImplementedError

    def motion_by(self, nodes: Any, reads: frozenset[str] | None = None) -> MotionJacobian:
        """Derivatives, by the nodes' moves, of the motions that loads read, or of these; nodes:
        those of the motion.
        """
        raise NotImplementedError

    def node_motion(self, kinematics: Any, nodes: Any = None) -> NodeMotion:
        """What acts between nodes sees; nodes: the motion's derivatives, where these are known."""
        raise NotImplementedError

    def idle(self, kinematics: Any) -> Tensor:
        """(...) bool: whether none of them does anything."""
        way = self.node_motion(kinematics).way()
        return element_loads.far(self.model, way, self.conditions).all(-1)

    def passed_through(self, kinematics: Any) -> Tensor | None:
        """(...) bool: whether the beam would pass through what it touches; None = it does not."""
        return None

    def element_balance(self, x: Any, kinematics: Any) -> ElementBalance:
        """The elements, whose nodes move so."""
        model = self.model
        return self.element.balance(
            model.multipliers.split(x.stress)[0],
            *(model.assembly.poses(*pose) for pose in kinematics.poses),
        )

    def residual(self, x: Any) -> tuple[Residual, Any, ElementBalance, InertiaForces | None]:
        """The balance at x; with it what the nodes and the elements do there."""
        model = self.model
        x = self.apply_supports(x)
        kinematics, inertia, load = self.node_balance(x)
        element, between = self.element_balance(x, kinematics), self.element_loads(kinematics)
        nodes = model.assembly.to_nodes(element.forces)
        asked = () if inertia is None else (inertia.wrench,)
        nodes = sum(asked, nodes if isinstance(load, float) else nodes - load)
        if between is not None:
            nodes = nodes - model.topology.scatter(between)
        gap = element.constitutive_residual
        if model.interactions:
            motion = self.node_motion(kinematics)
            for interaction in model.interactions:
                nodes, gap = interaction.balance(nodes, gap, x.stress, motion)
        restrained = restrained_forces(model, element.acting, self.eigenstrain, model.length)
        sizes = largest(
            model.space.dims.position,
            model.spans,
            element.forces,
            load,
            *asked,
            *(between or ()),
            restrained,
            *self.least,
        )
        span = model.spans.detach().sum((-1, -2))
        sizes = *sizes, size_of_strain(element.effective_strain, self.eigenstrain, span), span
        return (
            Residual(
                model.constraints,
                nodes,
                gap,
                *sizes,
                model.multipliers,
                self.rounding,
                self.element.rounding,
            ),
            kinematics,
            element,
            inertia,
        )

    def tangent(
        self, x: Any, kinematics: Any, element: ElementBalance, inertia: InertiaForces | None
    ) -> CondensedTangent:
        """By the nodes' moves."""
        model, assembly = self.model, self.model.assembly
        nodes, matrix = self.node_tangent(kinematics, inertia)
        tangent = self.element.tangent(
            element, model.multipliers.split(x.stress)[0], lambda: assembly.ends(nodes.half, 2)
        )
        condensed = CondensedTangent.of(
            assembly,
            tangent.stiffness,
            matrix,
            tangent.force_operator,
            self.C,
            tangent.strain_by_move,
        )
        if not model.interactions:
            return condensed
        motion, matrix = self.node_motion(kinematics, nodes), condensed.matrix
        for interaction in model.interactions:
            matrix = interaction.matrix(matrix, x.stress, motion)
        return condensed._replace(matrix=matrix)

    def merit(self, residual: Residual) -> Tensor | None:
        """See `Problem`."""
        return None

    @property
    def patient(self) -> bool:
        """See `Problem`."""
        return self.model.patient

    def near(self, x: Any) -> Tensor:
        """See `Problem`."""
        raise NotImplementedError

    def between(self, last: Any, x: Any, share: Tensor) -> Any:
        """See `Problem`."""
        raise NotImplementedError

    def telling(self, *about: Any) -> Told:
        """See `Problem`."""
        return {}

    def after(self, told: Told) -> BalanceProblem:
        """See `Problem`."""
        raise NotImplementedError

    def linearise(
        self, x: Any, kinematics: Any, element: ElementBalance, inertia: InertiaForces | None
    ) -> Linearisation:
        return Linearisation.of(self.model, self.tangent(x, kinematics, element, inertia))
