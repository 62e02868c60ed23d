"""Site: where a load acts at one instant, and how it is turned into force, moment and tangent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..beam import Beam
from ..quaternions import hat
from .values import Inputs

Wrench = tuple[Tensor | None, Tensor | None]  # force and moment (..., 3), frame a; None = absent


class Pose(NamedTuple):
    """Where a support is and how it moves: position (..., 3) m, R (..., 3, 3) its axes -> frame a, velocity (..., 3) m/s and
    spin (..., 3) rad/s absolute, frame a; None = at rest.
    """

    position: Tensor
    R: Tensor
    velocity: Tensor | None = None
    spin: Tensor | None = None


@dataclass(frozen=True)
class Site:
    """Where a load acts at one instant (of an implicit step: its middle), in frame a: (..., sites, ...) along the beam,
    (...) at one node.

    R         (..., 3, 3) section axes -> frame a
    mass      (..., 6, 6) mass per length about the site, point masses included, section axes; only along the beam
    position  (..., 3) m;  velocity (..., 3) m/s absolute;  spin (..., 3) rad/s absolute angular velocity, frame a's axes:
              None unless the effect reads them
    acceleration  (..., 3) m/s^2 absolute, likewise; None also where it is not known: an explicit form takes the derivative
              by it as a mass
    s         (..., sites) m, arclength of the sites from the root; only along the beam
    axes      (..., 3, 3) inertial axes -> frame a at this instant; None = they coincide
    support   node 0's prescribed pose, for effects that want it (`wants_support`)
    internal  (..., z) internal states of this effect at the start of the step, or at this instant where there is no step
    dt        (...) s, length of the step whose middle this is; None = there is no step
    """

    R: Tensor
    mass: Tensor | None = None
    position: Tensor | None = None
    velocity: Tensor | None = None
    spin: Tensor | None = None
    s: Tensor | None = None
    axes: Tensor | None = None
    support: Pose | None = None
    internal: Tensor | None = None
    dt: Tensor | None = None
    acceleration: Tensor | None = None

    def turn(self, v: Tensor) -> Tensor:
        """Section axes -> frame a."""
        return (self.R @ v[..., None])[..., 0]

    def from_inertial(self, v: Tensor) -> Tensor:
        """Inertial axes -> frame a, (..., 3) of the frame."""
        return v if self.axes is None else (self.axes @ v[..., None])[..., 0]


ROTATION, POSITION, VELOCITY, SPIN = READS = ("rotation", "position", "velocity", "spin")
ACCELERATION = "acceleration"  # read by loads that write their own tangent


class Acting:
    """What loads share. A load says what its wrench depends on (`depends`); its tangent comes by automatic differentiation
    unless it writes its own.
    """

    hook = "load"
    conservative = False
    wants_support = False  # whether it reads site.support
    wants_axes = False  # whether it reads site.axes
    depends: frozenset[str] = frozenset()

    def reads(self, beam: Beam) -> frozenset[str]:
        """Names among `READS` and "acceleration": what the wrench depends on; empty = a dead load."""
        return self.depends

    def moves(self, beam: Beam) -> bool:
        """Whether the wrench depends on how the beam stands or moves."""
        return bool(self.reads(beam))

    def wrench(self, site: Site, t: Tensor, inputs: Inputs) -> Wrench:
        """Force and moment in frame a, N and N m (per metre along the beam); None where absent."""
        raise NotImplementedError

    def tangent(self, site: Site, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        """Derivative (..., 6, 3) of [force; moment] by each name the wrench depends on: by displacement, by the spin s that
        turns R into (1 + ~s) R, by velocity, by angular velocity, all in frame a.
        """
        names = [name for name in READS if name in self.depends]
        at = [site.R.new_zeros(*site.R.shape[:-2], 3) if n == ROTATION else getattr(site, n) for n in names]

        def both(*xs: Tensor) -> Tensor:
            moved = {("R" if n == ROTATION else n): site.R + hat(x) @ site.R if n == ROTATION else x
                     for n, x in zip(names, xs, strict=True)}
            return together(self.wrench(replace(site, **moved), t, inputs), site.R)

        return dict(zip(names, jacobians(both, *at), strict=True))


def together(wrench: Wrench, like: Tensor) -> Tensor:
    """[force; moment] (..., 6), zeros where absent; `like` (..., 3, 3) has the sites' axes."""
    force, moment = (like.new_zeros(*like.shape[:-2], 3) if w is None else w for w in wrench)
    return torch.cat(torch.broadcast_tensors(force, moment), -1)


def jacobians(function: Callable[..., Tensor], *xs: Tensor) -> tuple[Tensor, ...]:
    """Derivatives (..., m, n) of function(*xs) (..., m) by each x (..., n), where the leading axes do not mix. By reverse
    mode: all x for the price of m cotangents; works where derivatives are switched off, and is differentiable itself.
    """
    out, pull = torch.func.vjp(function, *xs)
    lead, m = out.shape[:-1], out.shape[-1]
    if any(x.shape[:-1] != lead for x in xs):
        out, pull = torch.func.vjp(function, *(x.expand(*lead, x.shape[-1]) for x in xs))
    one_hot = torch.eye(m, dtype=out.dtype, device=out.device).reshape(m, *(1,) * len(lead), m).expand(m, *lead, m)
    return tuple(g.movedim(0, -2) for g in torch.func.vmap(pull)(one_hot))


Effect = Any  # any class with a `hook`
