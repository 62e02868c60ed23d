"""Warping of a prismatic beam's cross-section, and its compliance and mass, by finite elements.

Displacements are those of a section that stays plane, with the strains psi = (gamma1, kappa1,
kappa2, kappa3) of the axis, and the warping w of the section's points, three components each. With
the strain operators Gamma psi + B w + S dw/dx of a point, order [11 22 33 23 13 12], and Q its
stiffness, virtual work over a section without loads between the ends gives

    E w + R psi + C w' - (C^T w' + L psi' + M w'') = 0

with E = int B^T Q B, R = int B^T Q Gamma, C = int B^T Q S, L = int S^T Q Gamma, M = int S^T Q S.
Its solutions of extension, torsion and bending are constant along x, and those of transverse forces
linear, because dM/dx = -e1 x F (Giavotto et al. 1983, "Anisotropic beam theory and applications",
Computers and Structures 16, eqs. 24 to 36, where psi has six entries and E is bordered; the same
states follow from the four classical strains with the shear in the warping, and E alone remains):

    E W = -R                                        w = W psi + V psi',  psi' constant
    E V = -(C - C^T) W + L

The section's compliance is the energy of the six states of unit force or moment.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..core.validation import refusal
from ..math.quaternions import skew
from .elements import plain, rule
from .mesh import Mesh
from .sparse import Factors, solve

CLASSICAL = (0, 3, 4, 5)  # gamma1, kappa1, kappa2, kappa3 among the six


class Warping(NamedTuple):
    """What the solution of a mesh gives; columns [F1 F2 F3 M1 M2 M3] of unit force or moment.

    compliance: (..., 6, 6). mass: (..., 6, 6). warping: (..., n, 3, 6) m. strain: (..., e, g, 6, 6)
    at the points of integration. points: (..., e, g, 2) m. area: (..., e, g) m^2, their weights.
    """

    compliance: Tensor
    mass: Tensor
    warping: Tensor
    strain: Tensor
    points: Tensor
    area: Tensor


def solution(mesh: Mesh) -> Warping:
    """Compliance, mass and states of a mesh."""
    lead = torch.broadcast_shapes(mesh.nodes.shape[:-2], mesh.stiffness.shape[:-3])
    if 0 in lead:
        raise refusal("a batch without a sample", "one or more", are=True)
    nodes, cells = mesh.nodes.expand(*lead, *mesh.nodes.shape[-2:]), mesh.cells
    weight, N, dN = (x.to(nodes) for x in rule(cells.shape[-1]))
    corners = nodes[..., cells, :]  # (..., e, k, 2)
    points = N @ corners
    jacobian = torch.einsum("gka,...ekb->...egab", dN, corners)
    determinant = torch.linalg.det(jacobian)
    if not (right := plain(determinant) > 0).all():
        y, z = plain(points)[~right][0]
        raise refusal(
            f"a shape whose elements overlap or have no area at y = {y:.4g}, z = {z:.4g} m",
            "walls that leave room for each other",
            are=True,
        )
    area = weight * determinant
    slope = dN @ torch.linalg.inv(jacobian).mT  # (..., e, g, k, 2)
    Q = mesh.stiffness[..., None, :, :]
    B = torch.einsum("icb,...egkb->...egikc", _across(nodes), slope).flatten(-2)
    QB = area[..., None, None] * (Q @ B)  # (..., e, g, 6, 3 k)
    elements = (B.mT @ QB).sum(-3)
    factors = Factors(*_unknowns(nodes, cells))
    along = _along(nodes)  # (6, 3)
    axis = plane_strain(points)
    classical = axis[..., CLASSICAL]

    def assembled(parts: Tensor) -> Tensor:
        zero = torch.zeros(*lead, factors.size, parts.shape[-1], dtype=N.dtype, device=N.device)
        return zero.index_add(-2, factors.dofs.reshape(-1), parts.flatten(-3, -2))

    def at_points(w: Tensor) -> tuple[Tensor, Tensor]:
        """B w, and S w of w (..., 3 n, m), at the points."""
        local = w[..., factors.dofs, :]  # (..., e, 3 k, m)
        value = torch.einsum("gk,...ekcm->...egcm", N, local.unflatten(-2, (-1, 3)))
        return B @ local[..., None, :, :], along @ value

    def resultants(strain: Tensor) -> Tensor:
        stress = area[..., None, None] * (Q @ strain)
        return torch.einsum("...egia,...egim->...am", classical, stress)

    W = solve(elements, -assembled((QB.mT @ classical).sum(-3)), factors)
    strain = classical + at_points(W)[0]  # of unit psi
    inverse = torch.linalg.inv(resultants(strain))  # psi by F1, M1, M2, M3
    # psi' by F2 and F3: dM3/dx = -F2, dM2/dx = F3
    slopes = torch.stack((-inverse[..., 3], inverse[..., 2]), -1)
    grown = W @ slopes[..., :, :]
    stretched = at_points(grown)[1]
    stress = area[..., None, None] * (Q @ (strain @ slopes[..., None, None, :, :]))
    pulled = along.T @ stress  # (..., e, g, 3, 2)
    pulled = torch.einsum("gk,...egcm->...ekcm", N, pulled).flatten(-3, -2)
    V = solve(elements, assembled(pulled - (QB.mT @ stretched).sum(-3)), factors)
    sheared = at_points(V)[0] + stretched
    correction = -inverse @ resultants(sheared)
    sheared = sheared + strain @ correction[..., None, None, :, :]
    pure = strain @ inverse[..., None, None, :, :]
    states = torch.cat((pure[..., :1], sheared, pure[..., 1:]), -1)
    warping = torch.cat((W @ inverse[..., :1], V + W @ correction, W @ inverse[..., 1:]), -1)
    energy = area[..., None, None] * (states.mT @ (Q @ states))
    return Warping(
        energy.sum((-4, -3)), mass_of(points, area * mesh.density[..., None]),
        warping.unflatten(-2, (-1, 3)), states, points, area,
    )  # fmt: skip


def plane_strain(points: Tensor) -> Tensor:
    """(..., 6, 6) strains 11 22 33 23 13 12 at points (..., 2) of a section that stays plane, by
    [gamma; kappa]: gamma + kappa x (0, y, z).
    """
    y, z = points.unbind(-1)
    zero, one = torch.zeros_like(y), torch.ones_like(y)
    none = [zero] * 6
    rows = [
        *(one, zero, zero, zero, z, -y),
        *(none * 3),
        *(zero, zero, one, y, zero, zero),
        *(zero, one, zero, -z, zero, zero),
    ]
    return torch.stack(rows, -1).unflatten(-1, (6, 6))


def mass_of(points: Tensor, mass: Tensor) -> Tensor:
    """(..., 6, 6) of masses per length (..., e, g) kg/m at points (..., e, g, 2)."""
    r = skew(torch.nn.functional.pad(points, (1, 0)))
    m = mass[..., None, None]
    eye = torch.eye(3, dtype=m.dtype, device=m.device)
    corner, inertia = (m * r).sum((-4, -3)), (m * (r @ r.mT)).sum((-4, -3))
    top = torch.cat(((m * eye).sum((-4, -3)), -corner), -1)
    return torch.cat((top, torch.cat((corner, inertia), -1)), -2)


def _across(like: Tensor) -> Tensor:
    """(6, 3, 2): strains by the slopes d u_c / d(y, z)."""
    operator = torch.zeros(6, 3, 2, dtype=like.dtype, device=like.device)
    for i, c, b in ((1, 1, 0), (2, 2, 1), (3, 1, 1), (3, 2, 0), (4, 0, 1), (5, 0, 0)):
        operator[i, c, b] = 1
    return operator


def _along(like: Tensor) -> Tensor:
    """(6, 3): strains by du/dx."""
    operator = torch.zeros(6, 3, dtype=like.dtype, device=like.device)
    operator[0, 0] = operator[5, 1] = operator[4, 2] = 1
    return operator


def _unknowns(nodes: Tensor, cells: Tensor) -> tuple[Tensor, int, list[int]]:
    """Numbers (e, 3 k) of the elements' unknowns, how many there are, and four that are held: three
    of a node and the one across of a far node that no rigid motion of the section then leaves.
    """
    known = plain(nodes).reshape(-1, *nodes.shape[-2:])[0]
    arm = known - known[0]
    far = int((arm**2).sum(-1).argmax())
    across = 2 if abs(arm[far, 0]) > abs(arm[far, 1]) else 1
    dofs = (3 * cells[..., None] + torch.arange(3, device=cells.device)).flatten(-2)
    return dofs, 3 * nodes.shape[-2], [0, 1, 2, 3 * far + across]
