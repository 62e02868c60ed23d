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
WINDOWS = 8  # of the way to an equilibrium: z is then known to 0.011
LEAST = 1e-30  # of what a power is taken of


@dataclass(frozen=True)
class BoucWen(HystereticLaw):
    """Bouc-Wen law: a smooth hysteresis M = r k q + (1 - r) M_y z (Bouc 1967, Wen 1976).

        z' = (k/M_y) (q' - (beta |q'| |z|^(n - 1) z + gamma q' |z|^n))

    z tends to (beta + gamma)^(-1/n), which is 1 by default; k is the stiffness at z = 0. The law
    does not depend on the rate. It loses (1 - r) M_y |z|^(n + 1) (beta |q'| + gamma q' sign z).
    This is never negative for |gamma| <= beta (Erlicher and Point 2004). Along a way x = k q/M_y in
    one direction z, counted in it, follows z' = 1 - f(z) with f = |z|^n (gamma + beta sign z). A
    step takes

        z_1 = z_0 + x (1 - s f(z_0) - (1 - s) f(z_1))        s = 18/(36 + 6 X + X^2)

    with X = x times the steepest slope of f. It is of second order, as s = 1/2 - X/12 + ..., and z
    stays within its bound however long the step is, as x s f' <= 1. Its loss
    is x (s z_0 f(z_0) + (1 - s) z_1 f(z_1)) >= 0; the work of its mean load is stored and lost. It
    has derivatives everywhere but where a step turns around; there the slope is the mean of both.
    In an equilibrium z comes to its place by eight such steps, within 0.011.

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
        steepest, windows = self._steepest(w), 1 if moves else WINDOWS
        place, drop = (w, torch.zeros_like(w)), 0.0
        for _ in range(windows):
            place, mean, part = self._step(*place, per * size / windows, 1 / windows, steepest)
            drop = drop + part
        (load, by), q = (mean, (before + after) / 2) if moves else (place, after)
        by = torch.where(size == 0, (1 - self.gamma * z.abs() ** self.n) / (1 + moves), by)
        rest = (1 - self.ratio) * self.yield_moment
        load = self.ratio * self.stiffness * q + rest * sign * load
        slope = self.ratio * self.stiffness / (1 + moves) + rest * by * per
        after = sign * place[0], lost + rest * drop / per
        return Response(load, slope, torch.stack(torch.broadcast_tensors(*after), -1))

    def _step(
        self, w: Tensor, w_by: Tensor, way: Tensor, way_by: float, steepest: Tensor
    ) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor], Tensor]:
        """w (...) after a way >= 0, its mean, both with their derivatives, and the integral of
        what is lost: x = w + way (1 - share f(w) - (1 - share) f(x)), see the class.
        """
        n, turn = self.n, steepest * way
        share = 18 / (36 + 6 * turn + turn**2)
        share_by = -(share**2) * (3 + turn) / 9 * steepest * way_by
        f, f_by = self._fall(w)
        f_by = f_by * w_by
        b = w + way * (1 - share * f)
        side = torch.where(b < 0, -1.0, 1.0).to(b)
        shape = self.beta + side * self.gamma
        x = side * _root(side * b, way * (1 - share) * shape, n)
        g, g_x = self._fall(x)
        rise = w_by + way_by * (1 - share * f - (1 - share) * g)
        rise = rise - way * (share_by * (f - g) + share * f_by)
        x_by = rise / (1 + way * (1 - share) * g_x)
        lean, change = (1 - share) * g - share * f, (x - w) / 2
        lean_by = (1 - share) * g_x * x_by - share_by * (f + g) - share * f_by
        mean = (w + x) / 2 + change * lean
        mean_by = (w_by + x_by) / 2 + (x_by - w_by) / 2 * lean + change * lean_by
        return (x, x_by), (mean, mean_by), way * (share * w * f + (1 - share) * x * g)

    def _fall(self, w: Tensor) -> tuple[Tensor, Tensor]:
        """f and its derivative."""
        side = torch.where(w < 0, -1.0, 1.0).to(w)
        size = torch.clamp(w.abs(), min=LEAST)
        shape = self.beta + side * self.gamma
        power = shape * size**self.n
        return side * power, self.n * power / size

    def _steepest(self, w: Tensor) -> Tensor:
        """The largest slope of f on the way from w on."""
        down = torch.where(w < 0, w.abs(), 0.0)
        below = (self.beta - self.gamma) * torch.clamp(down, min=LEAST) ** (self.n - 1)
        below = torch.where(w < 0, below, 0.0)
        above = torch.clamp(self.beta + self.gamma, min=LEAST) ** (1 / self.n)
        return self.n * torch.where(below > above, below, above)

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
