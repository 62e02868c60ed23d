"""Bouc-Wen law of a joint's coordinate."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.leaves import leaf
from ..core.validation import Value, concrete, refusal, shown
from .coordinate_law import Response, Travel, rows
from .hysteresis import HystereticLaw, share

ITERATIONS = 5  # of Newton's method: then to rounding up to n = 10, to 1e-13 of the root at n = 20
WINDOWS = 4  # of the way to an equilibrium: z is then known to 0.01
LEAST = 1e-30  # of what a power is taken of


@dataclass(frozen=True)
class BoucWen(HystereticLaw):
    """Bouc-Wen law: a smooth hysteresis M = r k q + (1 - r) M_y z (Bouc 1967, Wen 1976).

        z' = (k/M_y) (q' - (beta |q'| |z|^(n - 1) z + gamma q' |z|^n))

    z tends to (beta + gamma)^(-1/n), which is 1 by default; k is the stiffness at z = 0. The law
    does not depend on the rate. It loses (1 - r) M_y |z|^(n + 1) (beta |q'| + gamma q' sign z).
    This is never negative for |gamma| <= beta (Erlicher and Point 2004). The midpoint rule of z
    keeps that in every step. It has derivatives everywhere but where a step turns around; there
    the slope is the mean of both. In an equilibrium z comes to its place by extrapolated implicit
    Euler steps, within 0.01.

    Memory: z; the energy lost, J.

    Args:
        stiffness: (...) k, N m/rad or N/m
        yield_moment: (...) M_y, N m, of a slider N
        ratio: (...) r, of the stiffness after yielding, 0 to 1
        n: (...) from 1 on: how sharp the corner is
        beta, gamma: (...) shape of the loop

    Raises:
        ValueError: for a stiffness, a yield moment or a beta that is not positive. For a ratio
            outside 0 to 1, n below 1, or a gamma beyond beta, by which it would give energy.

    Examples:
        >>> law = tb.BoucWen(stiffness=100.0, yield_moment=2.0, ratio=0.1, n=2.0)
        >>> door = tb.Scene({"door": beam}, joints=[tb.Hinge(None, ("door", 0), hysteresis=law)])
        >>> tb.rest(door).joint[0].memory  # z, J lost
        tensor([0., 0.])
    """

    stiffness: Value = leaf(rows, positive=True, copied=True)
    yield_moment: Value = leaf(rows, positive=True, copied=True)
    ratio: Value = leaf(rows, default=0.0, check=share)
    n: Value = leaf(rows, default=1.0, positive=True, copied=True)
    beta: Value = leaf(rows, default=0.5, positive=True, copied=True)
    gamma: Value = leaf(rows, default=0.5, finite=True, copied=True)

    def __post_init__(self) -> None:
        given = self.n, self.beta, self.gamma
        super().__post_init__()
        n, beta, gamma = (torch.as_tensor(x).detach() for x in (self.n, self.beta, self.gamma))
        if concrete(n < 1).any():
            raise refusal(f"BoucWen with n = {shown(given[0])}", "n from 1 on")
        if concrete(gamma.abs() > beta).any():
            raise ValueError(
                f"BoucWen with gamma = {shown(given[2])} beyond beta = {shown(given[1])} was "
                "given, which would give energy; |gamma| <= beta is wanted"
            )

    def response(self, travel: Travel) -> Response:
        before, after, memory, *_ = travel
        moves, (z, lost) = travel.dt is not None, memory.unbind(-1)
        way, per = after - before, self.stiffness / self.yield_moment
        sign = torch.where(way < 0, -1.0, 1.0).to(way)
        size, w = sign * way, sign * z
        still = size == 0
        if moves:
            mean, by = self._implicit(w, per * size / 2, torch.zeros_like(w))
            w_after, w_mean, by = 2 * mean - w, mean, by / 2
            q = (before + after) / 2
        else:
            w_after, by, drop = self._settled(w, per * size)
            w_mean, q = w_after, after
        by = torch.where(still, (1 - self.gamma * z.abs() ** self.n) * (0.5 if moves else 1), by)
        rest = (1 - self.ratio) * self.yield_moment
        load = self.ratio * self.stiffness * q + rest * sign * w_mean
        slope = self.ratio * self.stiffness * (0.5 if moves else 1) + rest * by * per
        lost = lost + rest * (w_mean * (size - (w_after - w) / per) if moves else drop / per)
        return Response(load, slope, torch.stack(torch.broadcast_tensors(sign * w_after, lost), -1))

    def _settled(self, w: Tensor, way: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """w (...) after a way >= 0, its derivative by that, and the integral of what is lost."""
        part, by, drop = way / WINDOWS, torch.zeros_like(w), torch.zeros_like(w)
        for _ in range(WINDOWS):
            whole, whole_by = self._implicit(w, part, by, 1 / WINDOWS)
            half = self._implicit(w, part / 2, by, 0.5 / WINDOWS)
            half, half_by = self._implicit(half[0], part / 2, half[1], 0.5 / WINDOWS)
            end, by = 2 * half - whole, 2 * half_by - whole_by
            drop = drop + part * (self._rate(w) + self._rate(end)) / 2
            w = end
        return w, by, drop

    def _rate(self, w: Tensor) -> Tensor:
        """What is lost, out of M_y, over the way."""
        shape = self.beta + torch.where(w < 0, -1.0, 1.0).to(w) * self.gamma
        return shape * torch.clamp(w.abs(), min=LEAST) ** (self.n + 1)

    def _implicit(
        self, w: Tensor, way: Tensor, w_by: Tensor, way_by: float = 1.0
    ) -> tuple[Tensor, Tensor]:
        """x = w + way (1 - |x|^n (gamma + beta sign x)), way >= 0, and its derivative where w and
        way have these.
        """
        b = w + way
        side = torch.where(b < 0, -1.0, 1.0).to(b)
        shape = self.beta + side * self.gamma
        y = _root(side * b, way * shape, self.n)
        power = torch.clamp(y, min=LEAST) ** self.n
        fall = 1 + self.n * way * shape * power / torch.clamp(y, min=LEAST)
        return side * y, (w_by + way_by * (1 - side * shape * power)) / fall

    def stored(self, coordinate: Tensor, memory: Tensor) -> Tensor:
        z = memory[..., 0]
        elastic = self.ratio * self.stiffness * coordinate**2
        return (elastic + (1 - self.ratio) * self.yield_moment**2 / self.stiffness * z**2) / 2


def _root(b: Tensor, c: Tensor, n: Tensor) -> Tensor:
    """y of y + c y^n = b, all >= 0, n >= 1: from above, where Newton's method keeps its side; the
    last step of it has the derivatives.
    """
    with no_derivatives():
        B, C = (torch.clamp(x, min=LEAST) for x in (b, c))
        y = torch.minimum(B, (B / C) ** (1 / n))
        for _ in range(ITERATIONS):
            y = y - (y + c * y**n - b) / (1 + n * c * y ** (n - 1))
        y = torch.clamp(y, min=LEAST)
        fall = 1 + n * c * y ** (n - 1)
    y, fall = y.detach(), fall.detach()
    return y - (y + c * y**n - b) / fall
