"""Elasto-plastic law of a joint's coordinate, with hardening."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..core.leaves import leaf
from ..core.validation import Value
from .coordinate_law import Response, Travel, rows
from .hysteresis import HystereticLaw, share


@dataclass(frozen=True)
class ElastoPlastic(HystereticLaw):
    """Elasto-plastic law with linear hardening: M = k (q - p), with the plastic part p of q.

    It yields where |M - X| = M_y + R: X = share H p is kinematic hardening (Prager), and
    R = (1 - share) H kappa is isotropic, with kappa the sum of all |dp|. The return to the yield
    surface is exact (Simo and Hughes 1998, box 1.5). So is the work of a step: the elastic part of
    it and the plastic one are integrated apart. Its mean load has a continuous derivative
    through the yield corner. Derivatives are one-sided in two places alone: in an equilibrium at
    the corner itself, and where a step turns around on the yield surface. There they are elastic.

    Memory: p rad or m; the energy lost, J, which is M_y kappa; kappa.

    Args:
        stiffness: (...) k, N m/rad or N/m
        yield_moment: (...) M_y, N m, of a slider N
        hardening: (...) H, N m/rad or N/m: the rise of M over the plastic part of q
        kinematic: (...) share of the hardening that is kinematic, 0 to 1

    Raises:
        ValueError: for a stiffness or a yield moment that is not positive, a negative hardening,
            or a share outside 0 to 1.

    Examples:
        >>> law = tb.ElastoPlastic(stiffness=100.0, yield_moment=2.0)
        >>> door = tb.Scene({"door": beam}, joints=[tb.Hinge(None, ("door", 0), hysteresis=law)])
        >>> tb.rest(door).joint[0].memory  # rad of plastic rotation, J lost
        tensor([0., 0.])
    """

    stiffness: Value = leaf(rows, positive=True, copied=True)
    yield_moment: Value = leaf(rows, positive=True, copied=True)
    hardening: Value = leaf(rows, default=0.0, nonnegative=True, copied=True)
    kinematic: Value = leaf(rows, default=1.0, check=share)

    memory = 3

    def response(self, travel: Travel) -> Response:
        before, after, memory, *_ = travel
        k, p, lost, kappa = self.stiffness, *memory.unbind(-1)
        X, R = self._hardened(p, kappa)
        M, way = k * (before - p), after - before
        sign = torch.where(way < 0, -1.0, 1.0).to(way)
        size = sign * way
        room = (self.yield_moment + R - sign * (M - X)) / k  # up to the yield surface
        beyond = size - torch.where(room > 0, room, 0.0)
        plastic = (beyond > 0) & (size > 0)
        beyond = torch.where(plastic, beyond, 0.0)
        share = k / (k + self.hardening)  # of the way beyond, that is plastic
        flow = share * beyond
        after_memory = p + sign * flow, lost + self.yield_moment * flow, kappa + flow
        if travel.dt is not None:
            safe = torch.where(plastic, size, 1.0)
            load = M + k * way / 2 - sign * k * flow * beyond / (2 * safe)
            slope = k / 2 - k * flow * (2 * size - beyond) / (2 * safe**2)
        else:
            load = M + k * (way - sign * flow)
            slope = k * (1 - torch.where(plastic, share, 0.0))
        return Response(load, slope, torch.stack(torch.broadcast_tensors(*after_memory), -1))

    def stored(self, coordinate: Tensor, memory: Tensor) -> Tensor:
        p, _, kappa = memory.unbind(-1)
        X, R = self._hardened(p, kappa)
        return (self.stiffness * (coordinate - p) ** 2 + X * p + R * kappa) / 2

    def _hardened(self, p: Tensor, kappa: Tensor) -> tuple[Tensor, Tensor]:
        """X and R."""
        along = self.kinematic * self.hardening
        return along * p, (self.hardening - along) * kappa
