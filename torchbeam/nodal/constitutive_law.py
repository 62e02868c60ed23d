"""Constitutive law of an element: what stress its strain, and the rate of that, bring about.

    S [F; M] = strain - eigenstrain + retardation (strain rate)

and where it has `arms`, which forget, the strain is what these make of it, see `maxwell_arms`.

S is the section's compliance. A zero on its diagonal makes a strain impossible: residuals keep S as
it is, and tangents take a small flexibility there, so that Newton's method loses nothing (see
`ElasticLaw.tangent_stiffness`). Matrices of uncoupled sections are stored as their diagonals,
(..., k, 1): see `times`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from ..core.derivatives import untracked
from ..core.leaves import Tree, leaf
from ..core.remembered import remembered
from ..core.validation import concrete
from ..scene.beam import Beam
from ..scene.effects.damping import Damping, geometric_means
from ..scene.scene import Scene
from .coordinates.spatial import Spatial
from .element_compliance import (
    REGULARISATION,
    coupled,
    element_compliance,
    impossible,
    regular_inverse,
    section_share,
    with_residual_bending,
)
from .maxwell_arms import MaxwellArms, arms_of

STIFFENED = 100.0  # by loads, over bending alone: P L^2/EI of that order


@dataclass(frozen=True)
class ElasticLaw(Tree):
    """S (..., N or 1, k, k) compliance, exact; C its inverse, regularised where a strain is
    impossible; both (..., k, 1) for an uncoupled section. `rigid`: whether any strain is
    impossible. arms: what its stress relaxes by, None = it does not.
    """

    S: Tensor = leaf(3)
    C: Tensor = leaf(3)
    rigid: bool
    arms: MaxwellArms | None = field(default=None, kw_only=True)

    damped = False

    def effective_strain(self, strain: Tensor, rate: Callable[[], Tensor]) -> Tensor:
        """The strain (..., N, k) that stress answers to; rate(): its rate, where it matters."""
        return strain

    def effective_strain_by(self, strain_by_move: Tensor, rate_by_strain: Tensor) -> Tensor:
        """Derivative of `effective_strain`, E (..., N, k, m) being that of the strain;
        rate_by_strain (...) 1/s.
        """
        return strain_by_move

    def constitutive_residual(self, effective_strain: Tensor, stress: Tensor) -> Tensor:
        """effective strain - S [F; M], (..., N, k): zero where the law holds."""
        return effective_strain - times(self.S, stress[..., None])[..., 0]

    def stress(self, effective_strain: Tensor) -> Tensor:
        """[F; M] (..., N, k)."""
        return times(self.C, effective_strain[..., None])[..., 0]

    def at_rest(self, strain: Tensor) -> Tensor:
        """What stress answers to of a strain (..., N, k) that lasts."""
        return strain if self.arms is None else self.arms.remaining * strain

    def at_rest_by(self, strain_by_move: Tensor) -> Tensor:
        """Derivative of `at_rest`, (..., N, k, m) being that of the strain."""
        if self.arms is None:
            return strain_by_move
        return self.arms.remaining[..., None] * strain_by_move

    def energy(self, strain: Tensor, crept: Tensor | None = None) -> Tensor:
        """(..., N, k) J/m, by component: e C e/2, or of arms that have crept by (..., N, m k) that
        of them and what they are beside. None = they have not.
        """
        if self.arms is None or crept is None:
            return self._energy(strain)
        energy, crept = self.arms.remaining * self._energy(strain), self.arms.each(crept)
        for share, q in zip(self.arms.shares.unbind(-1), crept.unbind(-1), strict=True):
            energy = energy + share * self._energy(strain - q)
        return energy

    def _energy(self, strain: Tensor) -> Tensor:
        """e C e/2 (..., N, k) J/m, by component; an impossible strain stores none, whatever
        rounding leaves of it.

        By a compliance that came as a matrix with zeros on its diagonal it has no derivative, and
        raises NotImplementedError. A strain e = S a stores S a^2/2, whose derivative at S = 0 is
        a^2/2, a being the force at the end of a step: midpoint steps know the mean over a step
        alone, about which a alternates from step to step.
        """
        if not self.rigid:
            return strain * self.stress(strain) / 2
        slim = self.S.shape[-1] == 1
        compliance = self.S if slim else self.S.diagonal(dim1=-2, dim2=-1)[..., None]
        strain = torch.where(compliance[..., 0] == 0, 0.0, strain)
        energy = strain * self.stress(strain) / 2
        if slim or untracked([self.S]):
            return energy
        return energy + 0.0 * _NoDerivative.apply(compliance)[..., 0]

    def dissipation(self, rate: Callable[[], Tensor]) -> Tensor | float:
        """(..., N, k) W/m that a strain rate takes out, by component."""
        return 0.0

    def tangent_stiffness(
        self, length: Tensor, line_mass: Tensor | None = None, dt: Tensor | None = None
    ) -> Tensor:
        """S^-1 for the tangent of a balance, or of a step of dt (0-dim or (...)) with a line mass
        (..., N+1, 1) kg/m; constant, in the form of S.

        Impossible strains, and in a step those next to impossible beside the softest bending or
        twist and the inertia, get a small flexibility: the tangent stays well conditioned.
        """
        S, h = self.S.detach(), length.detach()
        slim = S.shape[-1] == 1
        if not (self.rigid or (slim and dt is not None)) or not S.shape[-3]:
            return self.C.detach()
        diagonal = S if slim else S.diagonal(dim1=-2, dim2=-1)[..., None]
        bending, inertial, most = remembered(
            _surrounding_stiffness,
            h,
            None if line_mass is None else line_mass.detach(),
            dt,
            S.shape[-2],
        )
        if most is not None and not self.rigid and S.is_cpu and concrete(S >= most).all():
            return self.C.detach()  # as a rule
        softest = (diagonal * bending).amax((-3, -2), keepdim=True)
        # what bends round about; 1 in the place of 0
        around = bending * (STIFFENED * (softest + (softest == 0)).reciprocal())
        around = around if dt is None else around + inertial
        least = REGULARISATION[S.dtype] * around.reciprocal()
        if dt is None:
            least = torch.where(diagonal == 0, least, diagonal)
        else:
            least = torch.maximum(diagonal, least)
        return (
            least.reciprocal()
            if slim
            else torch.linalg.inv(S + torch.diag_embed((least - diagonal)[..., 0]))
        )


class _NoDerivative(torch.autograd.Function):
    """A compliance by which strain energy is not to be differentiated."""

    generate_vmap_rule = True

    @staticmethod
    def forward(compliance: Tensor) -> Tensor:
        return compliance.clone()

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor], output: Tensor) -> None:
        pass

    @staticmethod
    def backward(ctx: Any, derivative: Tensor) -> Any:
        raise NotImplementedError(ENERGY_BY_ZEROS)

    jvp = backward


ENERGY_BY_ZEROS = (
    "a derivative of the strain energy, which conserve=True reads too, by a compliance matrix with "
    "a zero on its diagonal was asked for; Section.from_stiffness, whose math.inf is no number to "
    "differentiate by, or a small compliance is wanted"
)


def _surrounding_stiffness(
    h: Tensor, line_mass: Tensor | None, dt: Tensor | None, k: int
) -> tuple[Tensor, Tensor | None, Tensor | None]:
    """Of k strains, (..., 1, k, 1): how stiff the whole beam is against each for a unit of bending
    stiffness, 1/L^2 or 1; N or N m^2: what the inertia of the longest element resists them with, in
    a step of dt (...); and the most that a strain's least flexibility is by that. None without dt.
    """
    moments = {6: 3, 3: 1}[k]  # strains that a moment brings about, in space and in a plane

    def of_strains(by_force: Tensor, by_moment: Tensor) -> Tensor:
        parts = torch.broadcast_tensors(*[by_force] * (k - moments), *[by_moment] * moments)
        return torch.cat(parts, -2)

    L2 = h.sum(-2, keepdim=True)[..., None] ** 2
    bending = of_strains(1 / L2, torch.ones_like(L2))
    if dt is None:
        return bending, None, None
    h2 = h.amax(-2, keepdim=True)[..., None] ** 2
    force = line_mass.amax(-2, keepdim=True)[..., None] * h2 * (2 / dt[..., None, None, None]) ** 2
    inertial = of_strains(force, force * h2)
    return bending, inertial, REGULARISATION[h.dtype] * inertial.reciprocal()


@dataclass(frozen=True)
class ViscoelasticLaw(ElasticLaw):
    """With a retardation time (Kelvin, Voigt): s, (..., 1, 1, 1), or a matrix in the form of S."""

    retardation_time: Tensor = leaf(3)

    damped = True

    def effective_strain(self, strain: Tensor, rate: Callable[[], Tensor]) -> Tensor:
        return strain + times(self.retardation_time, rate()[..., None])[..., 0]

    def effective_strain_by(self, strain_by_move: Tensor, rate_by_strain: Tensor) -> Tensor:
        return strain_by_move + rate_by_strain * times(self.retardation_time, strain_by_move)

    def dissipation(self, rate: Callable[[], Tensor]) -> Tensor:
        rate = rate()[..., None]
        return (rate * times(self.C, times(self.retardation_time, rate)))[..., 0]

    def damping_by(self, B: Tensor) -> Tensor:
        """C retardation B: stress by the rate of what B takes to strain."""
        return times(self.C, times(self.retardation_time, B))


def law_of(scene: Scene, space: Spatial) -> ElasticLaw:
    """The law of a scene's sections and its damping. Raises ValueError for six values of tau on a
    coupled or linked section with an impossible strain.
    """
    beam, rigid = scene.beam, any(impossible(scene.beam))
    compliance = element_compliance(beam)
    S = _slim(compliance, beam, space)
    if rigid or coupled(beam):
        resistance = _resistance(scene) if rigid else None
        C = _slim(regular_inverse(beam, compliance, resistance), beam, space)
    else:
        C = S.reciprocal()
    arms = arms_of(scene, space, section_share(beam, compliance)) if scene.arms else None
    if scene.damping is None:
        return ElasticLaw(S, C, rigid, arms=arms)
    retardations = [_retardation(damping, beam, space) for damping in scene.dampings]
    return ViscoelasticLaw(
        S,
        C,
        rigid,
        retardations[0] if scene.damping.on is None else _by_part(scene, retardations, S),
        arms=arms,
    )


def times(matrix: Tensor, x: Tensor) -> Tensor:
    """matrix @ x for x (..., k, n), where the matrix may be given as (..., k, 1), its diagonal, or
    (..., 1, 1), a factor.
    """
    return matrix * x if matrix.shape[-1] == 1 else matrix @ x


def _slim(matrix: Tensor, beam: Beam, space: Spatial) -> Tensor:
    if coupled(beam):
        return space.project_section(matrix)
    return space.project_diagonal(matrix.diagonal(dim1=-2, dim2=-1))[..., None]


def _resistance(scene: Scene) -> Tensor | None:
    """(...) N m/rad, the most by which joints and effects resist a turn of rigid links; None =
    nothing does.
    """
    beam = scene.beam
    length, mass = beam.length.sum(-1), (beam.mass[..., 0, 0] * beam.length).sum(-1)
    mass = sum((body.mass for body in getattr(beam, "masses", ())), mass)
    found = [joint.turning_resistance(length) for joint in scene.joints]
    found += [effect.turning_resistance(length, mass) for effect in scene.effects]
    found = [x.detach() for x in found if x is not None]
    if not found:
        return None
    most = torch.stack(torch.broadcast_tensors(*found))
    most = torch.where(most.isfinite(), most, 0.0).amax(0)
    return torch.where(most > 0, most, 1.0)


def _by_part(scene: Scene, retardations: list[Tensor], like: Tensor) -> Tensor:
    """Retardations of one beam each (..., N or 1, k or 1, *), in the form of S where one of them is
    a matrix: (..., N, *).
    """
    if any(retardation.shape[-2] > 1 for retardation in retardations):
        k = like.shape[-2]
        unit = (
            like.new_ones(k, 1)
            if like.shape[-1] == 1
            else torch.eye(k, dtype=like.dtype, device=like.device)
        )
        retardations = [
            retardation * unit if retardation.shape[-2] == 1 else retardation
            for retardation in retardations
        ]
    total = 0.0
    for retardation, damping in zip(retardations, scene.dampings, strict=True):
        (span,) = scene.beam.spans(damping)
        here = torch.zeros(scene.beam.station_count, 1, 1, dtype=like.dtype, device=like.device)
        here[span.stations] = 1
        total = total + here * retardation
    return total


def _retardation(damping: Damping, beam: Beam, space: Spatial) -> Tensor:
    """tau, or D^1/2 S^-1 D^1/2 with D = diag(tau): symmetric, never pumps energy. With linked
    interpolation the section's R = S D^1/2 S^-1 D^1/2 S, what a stress rate strains it by, becomes
    the element's as S does: R S^-1 of elements then.
    """
    tau = damping.tau
    if not damping.six:
        return tau[..., None, None, None]
    if not (coupled(beam) or beam.linked_interpolation):
        return space.project_section(torch.diag_embed(tau)).diagonal(dim1=-2, dim2=-1)[
            ..., None, :, None
        ]
    if any(beam.rigid):
        raise ValueError(
            "six-valued tau was given for a coupled or linked section with an impossible strain; "
            "one value is wanted there"
        )
    S = beam.compliance if beam.taper is None else element_compliance(beam)
    retardation = S @ (geometric_means(tau)[..., None, :, :] * torch.linalg.inv(S))
    if not beam.linked_interpolation or beam.taper is not None:
        return space.project_section(retardation)
    R = with_residual_bending(beam, retardation @ S)
    return _slim(R @ torch.linalg.inv(with_residual_bending(beam, S)), beam, space)
