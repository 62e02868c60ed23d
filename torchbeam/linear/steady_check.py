"""Whether the loads of a rotor look the same from it at every azimuth."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.validation import concrete
from ..equations.steady import Configuration, SteadyProblem
from ..nodal.model import Model
from ..scene.effects.custom_load import Load
from .bearing import Bearing

AZIMUTH = 1.0  # rad
CHANGES = 1e-6  # of the largest load, or moment over the extent
MOVED = 1e-3  # of the extent: how far nodes are moved to see what springs do


def unsteady(bearing: Bearing, problem: SteadyProblem, x: Configuration) -> str | None:
    """What keeps the rotor from a steady state: loads that change with the azimuth, or a force or a
    moment that turns on a support that yields. None = nothing does.
    """
    model, space = bearing.model, bearing.model.space
    with no_derivatives():
        axis = bearing.axis(x)
        unit = space.project_spin(axis.direction)
        centre = bearing.reduced(x, axis.point)[..., None, :]
        Q, Q_s = (
            torch.linalg.matrix_exp(AZIMUTH * X)[..., None, :, :]
            for X in (space.skew(unit), space.spin_skew(unit))
        )
        mask, p, by = bearing.rotor[:, None], space.dims.position, space.exponential(AZIMUTH * unit)
        shape = x.position.shape[-2:]
        moved = torch.cos(torch.arange(shape.numel()).to(x.position)).view(shape) * mask
        moved = x.position + MOVED * model.extent[..., None, None] * moved

        def loads(position: Tensor, turned: bool) -> tuple[Tensor, Tensor]:
            rotation = x.rotation
            if turned:
                position = torch.where(mask, centre + _times(Q, position - centre), position)
                rotation = space.normalize(space.multiply(by[..., None, :], rotation))
                rotation = torch.where(mask, rotation, x.rotation)
            total = mask * total_load(problem, Configuration(position, rotation, x.stress))
            return total[..., :p], total[..., p:]

        size = torch.stack([
            _largest(model, torch.cat(loads(place, False), -1)) for place in (x.position, moved)
        ]).amax(0)  # fmt: skip
        for place in (moved, x.position):
            f, m = loads(place, False)
            f_turned, m_turned = loads(place, True)
            change = torch.cat((f_turned - _times(Q, f), m_turned - _times(Q_s, m)), -1)
            if bool(concrete(_largest(model, change) > CHANGES * size).any()):
                return (
                    "loads on the rotor that change with its azimuth, as gravity across the axis "
                    "or a spring to the ground,"
                )
        if bearing.support is None:
            return None
        lever = x.position - centre
        moment = (m + _times(space.lever_matrix(lever).mT, f)).sum(-2)
        force = f.sum(-2)
        across = torch.cat(
            (_times(space.skew(unit), force), _times(space.spin_skew(unit), moment)), -1
        )
        if bool(concrete(_largest(model, across[..., None, :]) > CHANGES * size).any()):
            return "a rotor out of balance, whose force on its support turns with it,"
    return None


def refuse_own_axes(bearing: Bearing, problem: SteadyProblem, x: Configuration) -> None:
    """ValueError for a `Load` whose function has batch axes of its own, which would meet those of
    the speeds; at one speed, the shape as drawn.
    """
    scene = bearing.model.scene
    if not any(isinstance(effect, Load) for effect in scene.effects):
        return
    with no_derivatives():
        lead = total_load(problem, x).shape[:-2]
    beyond = lead[: len(lead) - len(scene.batch_shape)]
    if beyond.numel() > 1:
        raise ValueError(
            f"a Load whose function has batch axes {tuple(beyond)} of its own was given to "
            "campbell, where speeds have the first axis; Load(..., values=) is wanted, of batched "
            "numbers that the function takes by name"
        )


def total_load(problem: SteadyProblem, x: Configuration) -> Tensor:
    """(..., nodes, w) on all nodes, less their inertia."""
    total, between = problem.load(x), problem.element_loads(x)
    if between is not None:
        total = total + problem.model.topology.scatter(between)
    return total


def _largest(model: Model, load: Tensor) -> Tensor:
    """(...) N, of loads (..., nodes, w), moments over the extent of the whole."""
    return (load.abs() * model.unit.detach()[..., None, :]).amax((-1, -2))


def _times(A: Tensor, x: Tensor) -> Tensor:
    return (A @ x[..., None])[..., 0]
