"""Array operations of the mixed element, and the recursions along the chain."""

from __future__ import annotations

import torch
from torch import Tensor

from ..math.wiener_milenkovic import shadow


def cross(a: Tensor, b: Tensor) -> Tensor:
    """a x b, leading axes broadcast."""
    if a.ndim != b.ndim:
        a, b = torch.broadcast_tensors(a, b)
    return torch.linalg.cross(a, b)


def mv(A: Tensor, x: Tensor) -> Tensor:
    """A x for (..., n, m) and (..., m)."""
    return (A @ x[..., None])[..., 0]


def mtv(A: Tensor, x: Tensor) -> Tensor:
    """A^T x."""
    return mv(A.mT, x)


def halves(y: Tensor) -> tuple[Tensor, Tensor]:
    """(..., 6) -> two (..., 3)."""
    return y[..., :3], y[..., 3:]


def six(a: Tensor, b: Tensor) -> Tensor:
    """Two (..., 3) -> (..., 6)."""
    return torch.cat(torch.broadcast_tensors(a, b), -1)


def forward(first: Tensor, q: Tensor, jump: Tensor | None = None) -> Tensor:
    """Nodes n (..., N+1, m) of the averaged element: n_1 = first, n_{i+1} = 2 q_i - n_i; q
    (..., N, m), O(N).

    jump  (..., N, m, m) applied to n_i on entering element i: then the result holds, for each
          element, the value at its left end as that element sees it, and the tip.
    """
    if jump is None:
        sign = _signs(q.shape[-2], q)
        steps = torch.cumsum(sign * q, -2)
        inner = -sign * (first[..., None, :] - 2 * steps)
        return torch.cat((first[..., None, :].expand(*inner.shape[:-2], 1, -1), inner), -2)
    nodes = [first]
    for i in range(q.shape[-2]):
        nodes[i] = mv(jump[..., i, :, :], nodes[i])
        nodes.append(2 * q[..., i, :] - nodes[i])
    return torch.stack(torch.broadcast_tensors(*nodes), -2)


def backward(d: Tensor) -> Tensor:
    """W (..., N, m): W_N = d_N, W_i = d_i - W_{i+1}; d (..., N, m), O(N)."""
    sign = _signs(d.shape[-2], d)
    return sign * torch.cumsum((sign * d).flip(-2), -2).flip(-2)


def crossing(theta: Tensor, root: Tensor) -> Tensor | None:
    """Mask (..., N) of the elements that hold another chart than what lies on their left, the root
    or the element before: there the parameters differ less after `shadow`. None where no element
    does.
    """
    left = torch.cat((root[..., None, :].expand(*theta.shape[:-2], 1, 3), theta[..., :-1, :]), -2)
    q = left.square().sum(-1, keepdim=True)
    # |theta - shadow(left)| < |theta - left|, times |left|^2 so that left = 0 needs no care
    other = (theta * q + 16 * left).square().sum(-1) < (theta - left).square().sum(-1) * q[
        ..., 0
    ].square()
    return other if other.any() else None


def rotation_nodes(theta: Tensor, root: Tensor, other: Tensor | None) -> Tensor:
    """`forward` for rotation parameters: theta^_i as element i sees it; the tip, (..., N+1, 3)."""
    if other is None:
        return forward(root, theta)
    nodes = [root]
    for i in range(theta.shape[-2]):
        cross_here = other[..., i, None]
        safe = torch.where(cross_here, nodes[i], torch.ones_like(nodes[i]))
        nodes[i] = torch.where(cross_here, shadow(safe), nodes[i])
        nodes.append(2 * theta[..., i, :] - nodes[i])
    return torch.stack(torch.broadcast_tensors(*nodes), -2)


def chart_jump(arriving: Tensor, other: Tensor | None) -> Tensor | None:
    """d(shadow(n))/dn = -16 (I - 2 n n^T/q)/q where a chart is crossed, else I; None = nowhere."""
    if other is None:
        return None
    n = torch.where(other[..., None], arriving, torch.ones_like(arriving))
    q = n.square().sum(-1)[..., None, None]
    eye = torch.eye(3, dtype=n.dtype, device=n.device)
    return torch.where(
        other[..., None, None], -16 * (eye - 2 * n[..., :, None] * n[..., None, :] / q) / q, eye
    )


def _signs(N: int, like: Tensor) -> Tensor:
    """1, -1, 1, ... (N, 1)."""
    sign = torch.ones(N, 1, dtype=like.dtype, device=like.device)
    sign[1::2] = -1
    return sign
