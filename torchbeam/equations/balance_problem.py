"""What is solved: the balance of nodes and the law of elements, at rest or over a step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from torch import Tensor

from ..core.leaves import Tree
from ..nodal import interactions
from ..nodal.balance import (
    CondensedTangent,
    Linearisation,
    Residual,
    largest,
    restrained_forces,
    size_of_strain,
)
from ..nodal.conditions import Conditions
from ..nodal.frame import FixedFrame
from ..nodal.inertia import InertiaForces
from ..nodal.joint_motion import JointDrive, JointMotion
from ..nodal.loads import MotionJacobian, Nodes
from ..nodal.rows import Rows
from ..nodal.tendon_motion import TendonMotion
from ..nodal.touching_motion import TouchingMotion
from ..topology.protocols import Matrix
from .balanced_element import BalancedElement, ElementBalance


@dataclass(frozen=True)
class BalanceProblem(Tree):
    """inertia + to_nodes(h B^T [F; M]) - load = 0 at the nodes, gap = 0 in the elements, of rows
    under `conditions`.

    A subclass says what its unknowns x are, a named tuple of two tensors of nodes and of the
    `stress` (`apply_supports`, `update`); how nodes move by them, and what that asks for
    (`node_balance`, `node_tangent`); and the elements between (`element`).

    RATE  how far joints move, where they are closed, by a move of the nodes
    """

    model: Rows

    RATE: ClassVar[float] = 1.0

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
    def share(self) -> Tensor | float:
        """(...) as far as loads are raised."""
        return 1.0

    @property
    def least(self) -> tuple[Tensor, ...]:
        """Terms, as of elements or of nodes, that the balance is measured against beside its
        own.
        """
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
        """Derivatives of the motion, and those of inertia less loads, by the nodes' moves;
        None = none.
        """
        raise NotImplementedError

    def element_loads(self, kinematics: Any) -> tuple[Tensor, ...] | None:
        """Loads between nodes, on each node of the elements (..., N, w); None = there are none."""
        raise NotImplementedError

    def element_load_matrix(self, kinematics: Any, nodes: Any = None) -> Matrix | None:
        """What they add to the tangent; None = nothing. nodes: the derivatives of the motion, where
        they are known.
        """
        raise NotImplementedError

    def nodes(self, kinematics: Any) -> Nodes:
        """What loads see."""
        raise NotImplementedError

    def motion_by(self, nodes: Any) -> MotionJacobian:
        """Derivatives, by the nodes' moves, of the motions that loads read; nodes: those of the
        motion.
        """
        raise NotImplementedError

    def interactions(self, kinematics: Any) -> Tensor | float:
        """Of all, on the nodes (..., N+1, w); 0.0 where there is none."""
        if not self.conditions.interactions:
            return 0.0
        whole = interactions.at_nodes(self.model, self.nodes(kinematics), self.conditions)
        return whole if isinstance(self.share, float) else self.share[..., None, None] * whole

    def idle(self, kinematics: Any) -> Tensor:
        """(...) bool: whether none of them does anything."""
        raise NotImplementedError

    def passed(self, kinematics: Any) -> Tensor | None:
        """(...) bool: whether the beam would pass through what it touches; None = it moves through
        nothing.
        """
        return None

    def at_instants(
        self, kinematics: Any, place: Callable[[Tensor, Tensor], Any]
    ) -> tuple[Any, ...]:
        """place(position, rotation) of nodes where forces between them act, where they are after,
        and before a step (None = there is none).
        """
        raise NotImplementedError

    @property
    def joint_drive(self) -> JointDrive:
        """What acts in joints."""
        raise NotImplementedError

    def joint_poses(self, kinematics: Any) -> JointMotion:
        """Where joints are, and what acts in them."""
        return JointMotion(*self.at_instants(kinematics, self.model.joints.pose), self.joint_drive)

    def tendon_motion(self, kinematics: Any) -> TendonMotion:
        """Where tendons are, and what is given of them."""
        places = self.at_instants(kinematics, self.model.tendons.eyelets)
        return TendonMotion(*places, self.conditions.tendons, self.joint_drive)

    def touching_motion(self, kinematics: Any, nodes: Any = None) -> TouchingMotion:
        """How beams move that may touch each other; nodes: the derivatives of the motion, where
        they are known.
        """
        raise NotImplementedError

    def half_turns(self, nodes: Any) -> Callable[[], Tensor] | None:
        """Half the spin of a node's end by that of its move (..., N+1, s, s), of derivatives
        `nodes`; None = the end moves.
        """
        return None

    def element_balance(self, x: Any, kinematics: Any) -> ElementBalance:
        """The elements, whose nodes move so."""
        model = self.model
        return self.element.balance(
            model.joints.split(x.stress)[0],
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
        nodes, constitutive_residual = model.joints.balance(
            nodes, element.constitutive_residual, x.stress, lambda: self.joint_poses(kinematics)
        )
        restrained = restrained_forces(model, element.acting, self.eigenstrain, model.length)
        nodes = model.tendons.loaded(nodes, lambda: self.tendon_motion(kinematics))
        nodes = model.touching.loaded(nodes, lambda: self.touching_motion(kinematics))
        pushed = self.interactions(kinematics)
        nodes = nodes if isinstance(pushed, float) else nodes - pushed
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
        sizes = *sizes, size_of_strain(element.effective_strain, self.eigenstrain)
        return (
            Residual(
                model.constraints,
                nodes,
                constitutive_residual,
                *sizes,
                model.joints,
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
        assembly, joints = self.model.assembly, self.model.joints
        nodes, matrix = self.node_tangent(kinematics, inertia)
        tangent = self.element.tangent(
            element, joints.split(x.stress)[0], lambda: assembly.ends(nodes.half, 2)
        )
        condensed = CondensedTangent.of(
            assembly,
            tangent.stiffness,
            matrix,
            tangent.force_operator,
            self.C,
            tangent.strain_by_move,
        )
        half = self.half_turns(nodes)
        joined = joints.joined(
            condensed, x.stress, lambda: self.joint_poses(kinematics), half, self.RATE
        )
        matrix = self.model.tendons.matrix(
            joined.matrix, lambda: self.tendon_motion(kinematics), half, self.RATE
        )
        matrix = self.model.touching.matrix(matrix, lambda: self.touching_motion(kinematics, nodes))
        now = self.conditions
        if now.interactions:
            by, share = self.motion_by(nodes), self.share
            share = share if isinstance(share, float) else share[..., None, None, None]
            nodes = self.nodes(kinematics)
            matrix = interactions.matrix(self.model, nodes, now, by, matrix, -share)
        return joined if matrix is joined.matrix else joined._replace(matrix=matrix)

    def merit(self, residual: Residual) -> Tensor | None:
        """See `Problem`."""
        return None

    def near(self, x: Any) -> Tensor:
        """See `Problem`."""
        raise NotImplementedError

    def between(self, last: Any, x: Any, share: Tensor) -> Any:
        """See `Problem`."""
        raise NotImplementedError

    def by_secants(self, secant: Tensor) -> BalanceProblem:
        """See `Problem`."""
        return self

    def after(self, *about: Any) -> BalanceProblem:
        """See `Problem`."""
        return self

    def linearise(
        self, x: Any, kinematics: Any, element: ElementBalance, inertia: InertiaForces | None
    ) -> Linearisation:
        return Linearisation.of(self.model, self.tangent(x, kinematics, element, inertia))
