"""Elements whose section changes along them: what their ends show of it, beyond the mean.

Loads at the nodes leave an element a constant force F and a linear moment. With x from its middle,

    [F; M(x)] = T(x) [F; M],    T(x) = 1 - x N,    N = [[0, 0], [~e1, 0]]

so that the flexibility which its ends show is exact where it is statically determinate (force
method; Przemieniecki 1968, ch. 7):

    S_el = mean of T^T S T = S0 - N^T S1 - S1 N + N^T S2 N,    Sk = mean of x^k S

A uniform element has S_el = S + h^2/12 N^T S N. Plain elements leave out the second term: they bend
in their middle. Linked ones have it (MacNeal 1978). A plain element that tapers bends at the centre
C = S0^-1 S1 of its flexibility, and leaves out a part V of what is spread about it,

    S_plain = S_el - N^T V N,    V = G H^-1 G^T <= S2 - S1 S0^-1 S1
    G = h^2/12 + (C^T)^2,    H = mean of (x - C) K (x - C^T),    K = S^-1

V is h^2/12 S where the section is uniform. The inequality (Cauchy and Schwarz) keeps S_plain
positive for every taper; without shear flexibility it would be singular, and plain elements have
S_el. A soft end bends by the small moment that acts there: with the mean S0 alone, a wedge's last
element would bend as far as its tip does under the moment in the middle.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.functional import pad


def additions(
    S: Sequence[Tensor], K: Sequence[Tensor], h: Tensor, rigid: Sequence[bool] = (False,) * 6
) -> Tensor:
    """S_plain - S0 and S_el - S0, (..., N, 2, 6, 6), of elements of length h (..., N) m, by the
    means of x^k S and of x^k K (..., N, 6, 6), k = 0, 1, 2. K: see `inverse`; rigid: of 6 strains.
    """
    S0, S1, S2 = S
    N = S0.new_zeros(6, 6)
    N[4, 2], N[5, 1] = -1, 1  # ~e1
    linear = N.mT @ S1
    whole = N.mT @ S2 @ N - linear - linear.mT
    if any(rigid[1:3]):
        plain = whole
    else:
        free = 1 - S0.new_tensor([float(r) for r in rigid])
        plain = whole - N.mT @ (free[:, None] * _left_out(S, K, h, 1 - free) * free) @ N
    both = torch.stack(torch.broadcast_tensors(plain, whole), -3)
    return (both + both.mT) / 2


def _left_out(S: Sequence[Tensor], K: Sequence[Tensor], h: Tensor, rigid: Tensor) -> Tensor:
    """V (..., N, 6, 6), of no meaning in the rows where `rigid` (6,) is 1."""
    (S0, S1, _), (K0, K1, K2), eye = S, K, torch.eye(6).to(rigid)
    C = torch.linalg.solve(S0 + rigid.diag(), S1)
    G = C.mT @ C.mT + eye * (h**2 / 12)[..., None, None]
    across = C @ K1
    H = K2 - across - across.mT + C @ K0 @ C.mT
    return G @ torch.linalg.solve((H + H.mT) / 2, G.mT)


def inverse(S: Tensor, rigid: Sequence[bool]) -> Tensor:
    """S^-1 (..., 6, 6), with a stiffness of 1 against strains that are impossible."""
    return torch.linalg.inv(S + S.new_tensor([float(r) for r in rigid]).diag())


def residual_bending(S: Tensor, h: Tensor) -> Tensor:
    """h^2/12 N^T S N (..., N or 1, 6, 6) of uniform elements of length h (..., N) m: the residual
    bending flexibility, by which a force at the end shears an element that bends.
    """
    across = S.new_tensor(((0, 0, 0), (0, 0, -1), (0, 1, 0)))
    bent = across.mT @ S[..., 3:, 3:] @ across
    return pad(h[..., None, None] ** 2 / 12 * bent, (0, 3, 0, 3))
