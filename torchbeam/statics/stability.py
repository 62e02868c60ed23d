"""Stability of what stands still, by the pivots of its tangent: as many eigenvalues of a symmetric
matrix are negative as of its pivots (Haynsworth 1968).
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..equations.steady import Configuration, SteadyProblem
from ..math.quaternions import skew
from ..nodal import loads as external

NEUTRAL = 1e-4  # of the softest pivot at no load: a pivot that is less negative does not count
HAIR = 1e-3  # of the most negative pivot: an asymmetry that is less takes no instability away
SURE = 10.0  # times the forces out of balance: stresses that miss their strains are beside them
ROUNDING = 0.5  # power of the dtype's rounding


def eigenvalues(pivots: Tensor) -> Tensor:
    """(..., n, w) of pivot blocks, of their symmetric part."""
    return torch.linalg.eigvalsh((pivots + pivots.mT) / 2)


def sign(pivots: Tensor) -> Tensor:
    """(...) of the determinant."""
    return torch.linalg.slogdet(pivots).sign.prod(-1)


def unresisted(problem: SteadyProblem, x: Configuration, pivots: Tensor) -> Tensor:
    """(...) N/m, which pivots (..., n, w, w) by `Model.unit` may have where nothing resists:
    by rounding, and by forces out of balance at x, which such a motion turns.
    """
    model, size = problem.model, torch.linalg.matrix_norm(pivots, 2).amax(-1)
    off = problem.residual(x)[0].nodes * model.constraints.moving * model.unit[..., None, :]
    rounding = pivots.shape[-3] * torch.finfo(pivots.dtype).eps * size
    return rounding + SURE * off.abs().sum((-1, -2)) / model.extent


def conservative(problem: SteadyProblem, x: Configuration) -> Tensor:
    """() or (...) bool: whether the loads are at x, at rest."""
    return asymmetry(problem, x) == 0


def asymmetry(problem: SteadyProblem, x: Configuration) -> Tensor:
    """() or (...) N/m: how far the loads' tangent at x, at rest, by `Model.unit`, is from that of a
    gradient, of a moment m by the spin ~m/2 beside what is symmetric; 0 where they are declared
    conservative, or no further from it than rounding; inf where this is not known.
    """
    model, now = problem.model, problem.conditions
    none = x.position.new_zeros(())
    if model.conservative:
        return none
    others, between = (
        tuple(act for act in acts if not model.declared(act.load))
        for acts in (now.loads, now.between + now.interactions)
    )
    if between or model.internal_states or not model.conserves:
        return none + torch.inf
    nodes, own, p = problem.nodes(x), replace(now, loads=others), model.space.dims.position
    force = external.external(model, nodes, own)
    if isinstance(force, float):  # none acts
        return none
    moment = force[..., p:]
    slope = external.tangent(model, nodes, own, problem.frame.steady_jacobian())
    if isinstance(slope, float):
        slope = moment.new_zeros(*moment.shape[:-1], *(model.space.unknowns,) * 2)
    by_spin, terms = slope[..., p:, p:], []
    if model.space.turns and moment.shape[-1] == 3:
        by_spin = by_spin + skew(moment) / 2
        terms = [moment]
    pairs = (
        (slope[..., :p, :p], slope[..., :p, :p], ()),
        (slope[..., :p, p:], slope[..., p:, :p], ()),
        (by_spin, by_spin, terms),
    )
    alike = torch.stack([_alike(a, b.mT, *more) for a, b, more in pairs]).all(0)
    size = model.unit[..., None, None, :]
    slope = torch.cat((slope[..., :p], torch.cat((slope[..., :p, p:], by_spin), -2)), -1)
    off = (size.mT * (slope - slope.mT) / 2 * size).abs().amax((-1, -2)).sum(-1)
    return torch.where(alike, 0.0, off)


def _alike(a: Tensor, b: Tensor, *more: Tensor) -> Tensor:
    """(...) whether (..., n, *, *) are, beside the largest of their numbers and of more."""
    size = sum(v.abs().flatten(k).amax(-1) for k, v in ((-3, a), (-3, b), *((-2, m) for m in more)))
    limit = torch.finfo(a.dtype).eps ** ROUNDING
    return (a - b).abs().flatten(-3).amax(-1) <= limit * size
