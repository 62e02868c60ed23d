"""Riccati's equation, and the gains of discrete linear models that it gives."""

from __future__ import annotations

import torch
from torch import Tensor

DOUBLINGS = 60  # of the horizon of a Riccati recursion, at most


def delayed_gain(A: Tensor, B: Tensor, Q: Tensor, effort: float, delay: int) -> Tensor:
    """K of u = -K [z; pending actions], of actions (a) that act `delay` intervals later: least sum
    of z'Qz + effort |u|^2.
    """
    n, actions = B.shape
    whole = A.new_zeros(n + actions * delay, n + actions * delay)
    whole[:n, :n] = A
    acts = A.new_zeros(len(whole), actions)
    if delay:
        whole[:n, n : n + actions] = B
        whole[n:-actions, n + actions :] = torch.eye(actions * (delay - 1), dtype=A.dtype)
        acts[-actions:] = torch.eye(actions, dtype=A.dtype)
    else:
        acts[:n] = B
    cost = torch.zeros_like(whole)
    cost[:n, :n] = Q
    return gain(whole, acts, cost, effort * torch.eye(actions, dtype=A.dtype))


def gain(A: Tensor, B: Tensor, Q: Tensor, R: Tensor) -> Tensor:
    """K (m, n) of u = -K x that minimises the sum of x'Qx + u'Ru for x_{k+1} = A x_k + B u_k."""
    P = riccati(A, B, Q, R)
    return torch.linalg.solve(R + B.mT @ P @ B, B.mT @ P @ A)


def riccati(A: Tensor, B: Tensor, Q: Tensor, R: Tensor) -> Tensor:
    """P (n, n): x'Px is the least sum of x'Qx + u'Ru from x on.

    Solution of the discrete algebraic Riccati equation by structure-preserving doubling (Chu, Fan,
    Lin and Wang 2004): each round doubles the horizon. Raises ValueError where it does not
    converge: the model cannot be stabilised.
    """
    X, G, H = A, B @ torch.linalg.solve(R, B.mT), Q
    eye = torch.eye(len(A), dtype=A.dtype, device=A.device)
    for _ in range(DOUBLINGS):
        W = torch.linalg.solve(eye + G @ H, torch.cat((X, G), -1))
        V, Z = W.split(len(A), -1)  # (I + G H)^-1 X, (I + G H)^-1 G
        more = X.mT @ H @ V
        X, G, H = X @ V, G + X @ Z @ X.mT, H + (more + more.mT) / 2
        G = (G + G.mT) / 2
        if not torch.isfinite(H).all():
            break
        if more.abs().amax() <= 1e-12 * H.abs().amax():
            return H
    raise ValueError(
        f"a model of {len(A)} states was given for which Riccati's equation has no solution; one "
        "that the actions can stabilise is wanted"
    )
