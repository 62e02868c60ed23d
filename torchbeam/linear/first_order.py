"""First-order form of small motions

    M q'' + D q' + K q = G du        dy = Y q + Y_v q' + Y_u du

Coordinates q_0 without inertia (turns of a section without rotary inertia) have no equation of
motion. Undamped they follow the others, K_00 q_0 = G_0 du - K_01 q_1; damped they creep,
D_00 q_0' = G_0 du - K_00 q_0 - K_01 q_1 - D_01 q_1'. Internal states of loads are such coordinates,
see `system_matrices`; they also follow accelerations, - M_01 q_1'' on the right.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..core.leaves import wants_gradient
from ..math.dense import solve

SINGULAR = 1e-13


class SmallMotions(NamedTuple):
    """M, D, K (..., n + Z, n + Z), G (..., n + Z, m), Y, Y_v (..., p, n + Z), Y_u (..., p, m) of n
    moves, and behind them Z internal states.
    """

    M: Tensor
    D: Tensor
    K: Tensor
    G: Tensor
    Y: Tensor
    Y_v: Tensor
    Y_u: Tensor


class FirstOrder(NamedTuple):
    """Matrices A, B, C, D of z' = A z + B du, dy = C z + D du; whether coordinates without inertia
    creep; mass of the first moves of z where all moves have inertia, else None.
    """

    A: Tensor
    B: Tensor
    C: Tensor
    D: Tensor
    creeps: bool
    mass: Tensor | None


def first_order(small: SmallMotions, massless: Tensor, states: int) -> FirstOrder:
    """massless (n,) bool, of the moves; behind them come `states` internal states. Raises
    ValueError as `linearize`.
    """
    massive, light = (~massless).nonzero()[:, 0], massless.nonzero()[:, 0]
    internal = torch.arange(len(massless), len(massless) + states, device=massless.device)
    D = small.D
    creeps = len(light) > 0 and bool((D[..., light, :].detach() != 0).any())
    if len(light) and not creeps:  # q_0 = follow u - lead q
        small = _following(small, massive, light, internal)
        massive, light = torch.arange(len(massive), device=massive.device), light[:0]
        internal = len(massive) + torch.arange(states, device=massive.device)
    elif creeps:
        least, most = torch.linalg.svdvals(D[..., light, :][..., light].detach()).aminmax(dim=-1)
        if (least <= SINGULAR * most).any():
            raise ValueError(
                "damping of some strains alone was given for a section without rotary inertia; "
                "damping of all of them, or a rotary inertia, is wanted"
            )
    light = torch.cat((light, internal))
    if len(light):
        return _creeping(small, massive, light, creeps, states)
    (M,), (D,), (K,) = (_parts(X, massive) for X in small[:3])
    G, Y, V = small.G[..., massive, :], small.Y[..., massive], small.Y_v[..., massive]
    rows = solve(M, torch.cat((-K, -D, G), -1))
    n = 2 * len(massive)
    eye = torch.eye(len(massive), dtype=K.dtype, device=K.device).expand_as(K)
    A = torch.cat((torch.cat((torch.zeros_like(K), eye), -1), rows[..., :n]), -2)
    B = torch.cat((torch.zeros_like(G), rows[..., n:]), -2)
    return FirstOrder(A, B, torch.cat((Y, V), -1), small.Y_u, False, M)


def _parts(X: Tensor, *groups: Tensor) -> list[Tensor]:
    return [X[..., i, :][..., j] for i in groups for j in groups]


def _following(
    small: SmallMotions, massive: Tensor, light: Tensor, internal: Tensor
) -> SmallMotions:
    """Of the massive coordinates and internal states alone, which the light ones follow."""
    M, D, K, G, Y, Y_v, Y_u = small
    rest = torch.cat((massive, internal))
    if any(_coupled(X[..., internal, :], light, massive) for X in (D, M)):
        raise ValueError(
            "internal states of a load that follow the rate of a turn without inertia were "
            "given; a section with rotary inertia, or damping, is wanted"
        )
    K00, K10 = K[..., light, :][..., light], K[..., rest, :][..., light]
    lead, follow = solve(K00, torch.cat((K[..., light, :][..., rest], G[..., light, :]), -1)).split(
        (len(rest), G.shape[-1]), -1
    )
    Y_u = Y_u + Y[..., light] @ follow
    Y, Y_v = (X[..., rest] - X[..., light] @ lead for X in (Y, Y_v))
    G = G[..., rest, :] - K10 @ follow
    back = solve(K00.mT, K10.mT).mT
    M, D, K = (_condensed(X, rest, light, lead, back) for X in (M, D, K))
    return SmallMotions(M, D, K, G, Y, Y_v, Y_u)


def _creeping(
    small: SmallMotions, massive: Tensor, light: Tensor, creeps: bool, states: int
) -> FirstOrder:
    """With light coordinates, the last of them `states` internal states, that follow a rate."""
    M, D, K, G, Y, Y_v, Y_u = small
    K11, K10, K01, K00 = _parts(K, massive, light)
    D11, D10, D01, D00 = _parts(D, massive, light)
    M11, M10, M01, M00 = _parts(M, massive, light)
    G1, G0 = G[..., massive, :], G[..., light, :]
    creep = solve(D00, torch.cat((-K01, -K00, -D01, G0, -M01), -1))
    creep, pushed = creep[..., : -len(massive)], creep[..., -len(massive) :]
    right = torch.cat((-K11, -K10, -D11, G1), -1) - D10 @ creep
    rows = solve(M11 + D10 @ pushed, right)
    creep = creep + pushed @ rows
    n = 2 * len(massive) + len(light)
    eye = torch.eye(len(massive), dtype=K.dtype, device=K.device).expand_as(K11)
    top = torch.cat((torch.zeros_like(K11), torch.zeros_like(K10), eye), -1)
    # they are 0, and their derivatives are not: q_0'' is that of the creep
    if wants_gradient(M00, M10):
        whole = torch.cat((torch.cat((top, torch.zeros_like(G1)), -1), creep, rows), -2)
        turns = creep[..., :n] @ whole
        late = solve(D00, M00 @ turns)
        less = solve(M11 + D10 @ pushed, M10 @ turns - D10 @ late)
        creep, rows = creep - late - pushed @ less, rows - less
    A = torch.cat((top, creep[..., :n], rows[..., :n]), -2)
    B = torch.cat((torch.zeros_like(G1), creep[..., n:], rows[..., n:]), -2)
    V = Y_v[..., light]
    C = torch.cat((Y[..., massive], Y[..., light], Y_v[..., massive]), -1) + V @ creep[..., :n]
    first = n - len(massive) - states
    order = torch.tensor(
        [*range(first), *range(first + states, n), *range(first, first + states)], device=A.device
    )
    return FirstOrder(
        A[..., order, :][..., order],
        B[..., order, :],
        C[..., order],
        Y_u + V @ creep[..., n:],
        creeps,
        M11 if len(light) == states else None,
    )


def _condensed(X: Tensor, rest: Tensor, none: Tensor, lead: Tensor, back: Tensor) -> Tensor:
    """[I, -back] X [I; -lead] of the coordinates `rest`, where those of `none` follow as -lead q
    (Guyan 1965). What M and D have of `none` is 0, and its derivative is not: of a rotary inertia,
    or damping, that is 0.
    """
    upper, lower = X[..., rest, :], X[..., none, :]
    upper, lower = (x[..., rest] - x[..., none] @ lead for x in (upper, lower))
    return upper - back @ lower


def _coupled(rows: Tensor, light: Tensor, massive: Tensor) -> bool:
    """Whether the columns `light` of some rows are more than rounding beside the `massive` ones."""
    rows = rows.detach().abs()
    return rows.numel() > 0 and bool(
        (rows[..., light] > SINGULAR * rows[..., massive].amax((-1, -2), keepdim=True)).any()
    )
