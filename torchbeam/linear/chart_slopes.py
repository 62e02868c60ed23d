"""Slopes of a chart: derivatives of the coordinates of a state by its moves, and of the moves by
coordinates.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..math.block_matrices import of_blocks, with_identity
from ..math.dense import inverse_unchecked
from ..math.shapes import broadcast_shapes, stacked
from ..nodal.coordinates.spatial import Spatial
from ..nodal.moves import moved, remembered_count
from ..state.state import State
from .chart import Chart, Place


def slopes(chart: Chart, state: State, place: Place | None = None) -> tuple[Tensor, Tensor]:
    """Derivatives of `chart.coordinates` by a move of the state (see `nodal.moves`), (..., 2 w
    (N+1) + Z, 2 w (N+1) + Z), and of the move by coordinates, where what supports hold stays, and
    what joints hold. With u the velocities less those of the model's own motion,

        dq = J m        dq' = J (v - W m) + d(J u)/dm m
        (W: what the model's own spin makes of a displacement)

    and of what joints hold likewise, 0 = G m and 0 = G (v - W m) + d(G u)/dm m.

    place: of the state, None = not known.
    """
    space, u, free = chart.space, chart.velocity(state), chart.free
    _, J = chart.place(state) if place is None else place
    rows = chart.independent_and_held(state.position, state.rotation, J)
    before = space.to_frame(chart.own.rotation, chart.own.spin)
    carried = _of_each(pad(space.skew(before), (0, space.dims.spin, 0, space.dims.spin)))
    rate, held_rate = _by_moves_of_rate(chart, state, u)
    rows_rate = chart.independent @ rate
    if held_rate is not None:
        rows_rate = stacked(rows_rate, held_rate)
    rate, rows_rate = rate - J @ carried, rows_rate - rows @ carried
    states = remembered_count(chart.own)
    back = inverse_unchecked(rows[..., free])
    after = _triangular(back, -back @ rows_rate[..., free] @ back, states)
    w = J.shape[-1]
    at = torch.cat((free, w + free, 2 * w + torch.arange(states, device=free.device)))
    whole = after.new_zeros(*after.shape[:-2], 2 * w + states, after.shape[-1])
    independent = pad(chart.independent, (0, 0, 0, len(free) - chart.independent.shape[-2]))
    whole = whole.index_copy(-2, at, after) @ _triangular(
        independent, torch.zeros_like(independent), states
    )
    return _triangular(J.expand_as(rate), rate, states), whole


def _by_moves_of_rate(chart: Chart, state: State, u: Tensor) -> tuple[Tensor, Tensor | None]:
    """d(J u)/dm (..., w (N+1), w (N+1)) by moves m of the nodes, with u (..., N+1, w) as it is in
    frame a; and (..., m, w (N+1)) that of the rates of what joints hold, None without.

    The geometric stiffness of a stress is the derivative of h B^T stress: that of a unit stress,
    times u, is that of the rate of its strain.
    """
    space, length = chart.space, chart.length
    kinematics = chart.kinematics(state.position, state.rotation)
    ends = chart.assembly.to_elements(u)
    eye = torch.eye(space.dims.strain, dtype=u.dtype, device=u.device)
    lead = broadcast_shapes(ends.shape[:-1], kinematics[0].shape[: u.ndim - 1])
    unit = eye.view(-1, *(1,) * len(lead), space.dims.strain).expand(-1, *lead, -1)
    K = space.geometric_stiffness(kinematics, unit, length)
    strains = torch.einsum(
        "k...ea,k...eab->...ekb",
        (ends / length).expand(len(eye), *lead, -1),
        K.expand(len(eye), *lead, *K.shape[-2:]),
    )
    strains = torch.einsum("...ekb,meb->...ekm", strains, chart.unit_moves).flatten(-3, -2)
    p, w = space.dims.position, space.unknowns
    bases = strains.new_zeros(*strains.shape[:-2], w * len(chart.bases), strains.shape[-1])
    if space.turns and space.dims.spin > 1:
        for k, base in enumerate(chart.bases):
            by_turn = _rate_of_turn(
                space.of_nodes(base), chart.turned(state.rotation, base), u[..., base, p:]
            )
            bases[..., k * w + p : (k + 1) * w, base * w + p : (base + 1) * w] = by_turn
    rows, held = torch.cat((bases, strains), -2), None
    if chart.joints.count:
        coordinates, held = _by_moves_of_joints(chart, state, u)
        rows = stacked(rows, coordinates)
    return chart.solve @ rows, held


def _by_moves_of_joints(chart: Chart, state: State, u: Tensor) -> tuple[Tensor, Tensor]:
    """Derivatives by moves of the nodes of the rates that u makes of joints' coordinates
    (..., c, w (N+1)), and of what joints hold (..., m, w (N+1)).
    """
    joints, start, u = chart.joints, state.detach(), u.detach().flatten(-2)[..., None]

    def rates(m: Tensor) -> list[Tensor]:
        after = moved(chart.space, start, pad(m, (0, start_rates)))
        pose = joints.pose(after.position, after.rotation)
        return [(rows(pose) @ u)[..., 0] for rows in (joints.coordinate_rows, joints.held_rows)]

    count, start_rates = u.shape[-2], u.shape[-2] + remembered_count(start)
    lead = broadcast_shapes(state.position.shape[:-2], state.rotation.shape[:-2], u.shape[:-2])
    sizes = [x.shape[-1] for x in rates(u.new_zeros(*lead, count))]
    with torch.enable_grad():
        m = u.new_zeros(sum(sizes), *lead, count, requires_grad=True)
        rows = torch.cat(rates(m), -1).movedim(-1, 1)  # each of the copies of m gives all
        (by,) = torch.autograd.grad(rows.diagonal().sum(), m)
    return by.movedim(0, -2).split(sizes, -2)


def _of_each(blocks: Tensor) -> Tensor:
    """Block diagonal (..., n w, n w) of blocks (..., n, w, w)."""
    n = blocks.shape[-3]
    eye = torch.eye(n, dtype=blocks.dtype, device=blocks.device)
    return (eye[:, None, :, None] * blocks[..., :, :, None, :]).flatten(-4, -3).flatten(-2)


def _triangular(A: Tensor, below: Tensor, states: int) -> Tensor:
    """[[A, 0, 0], [below, A, 0], [0, 0, I]], with so many rows of I."""
    return with_identity(of_blocks(A, torch.zeros_like(A), below, A), states)


def _rate_of_turn(space: Spatial, q: Tensor, spin: Tensor) -> Tensor:
    """Derivative (..., s, s) by a left turn of what a spin (..., s) makes of the logarithm of q."""
    lead, s = broadcast_shapes(q.shape[:-1], spin.shape[:-1]), space.dims.spin
    with torch.enable_grad():
        x = spin.new_zeros(s, *lead, s, requires_grad=True)
        turned = space.multiply(space.exponential(x), q.detach())
        rate = (space.logarithm_by_turn(turned).mT @ spin.detach()[..., None])[..., 0]
        (slope,) = torch.autograd.grad(rate.movedim(0, -1).diagonal(dim1=-2, dim2=-1).sum(), x)
    return slope.movedim(0, -2)
