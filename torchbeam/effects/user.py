"""Load: any effect that a function can say, with internal states of its own where it wants them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..checks import count
from .loads import whole_node
from .site import READS, Acting, Site, Wrench, jacobians
from .values import Input, Inputs, value_at


@dataclass(frozen=True)
class Load(Acting):
    """A load by a function of the motion: `function(position, rotation, velocity, spin, t, **inputs)` -> (force, moment).

    function  position (..., 3) m, rotation (..., 3, 3) section axes -> frame a, velocity (..., 3) m/s absolute, spin (..., 3)
              rad/s, all in frame a; t (0-dim) s. Returns force and moment (..., 3) in frame a, N and N m, per metre along the
              beam; None = absent. Written in torch operations; what it returns for a site depends on that site alone.
    node      counts from the root, -1 is the tip; None = along the beam, where the arguments are (..., sites, ...)
    inputs    `Input`s, or names with sizes {"u": 2}: the function takes them by name
    internal  how many internal states z it has (actuator lag, inflow), at a node only; it then takes `z` (..., internal) by
              name as well
    rate      z' = rate(z, position, rotation, velocity, spin, t, **inputs), 1/s of z; z starts at zero
    of        what the function looks at, of "position", "rotation", "velocity", "spin"; the others are given as None, and
              their derivatives are not taken. Empty: a load of t, inputs and z.

    The tangent comes by automatic differentiation. In an implicit step z is taken at mid step, linearly implicit,

        z_mid = z_n + (I - dt/2 dg/dz)^-1 dt/2 g(z_n, ...),    z_{n+1} = 2 z_mid - z_n

    which for a linear law is the midpoint rule, and is stable for any lag (Rosenbrock 1963).

    Raises ValueError for internal states without a rate or a node, a rate without them, or unknown names in `of`.
    """

    function: Callable[..., tuple[Tensor | None, Tensor | None]]
    node: int | None = -1
    inputs: Iterable[Input] | dict[str, int] = ()
    internal: int = 0
    rate: Callable[..., Tensor] | None = None
    of: Sequence[str] = READS

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise ValueError(f"{self.function!r} was given to Load; a function of the motion is wanted")
        if self.node is not None:
            whole_node(self.node)
        count("internal", self.internal, least=0)
        if bool(self.internal) != (self.rate is not None):
            given = "internal states without a rate" if self.internal else "a rate without internal states"
            raise ValueError(f"{given} was given to Load; both or neither are wanted")
        if self.internal and self.node is None:
            raise ValueError("internal states of a Load along the beam were given; one Load for each node is wanted")
        inputs = [Input(n, size) for n, size in self.inputs.items()] if isinstance(self.inputs, dict) else list(self.inputs)
        if not all(isinstance(i, Input) for i in inputs):
            raise ValueError(f"{self.inputs!r} was given as Load's inputs; Inputs, or names with sizes, are wanted")
        of = (self.of,) if isinstance(self.of, str) else tuple(self.of)
        for name in of:
            if name not in READS:
                raise ValueError(f"of = {name!r} was given; {', '.join(READS)} are there")
        object.__setattr__(self, "inputs", tuple(inputs))
        object.__setattr__(self, "of", of)

    @property
    def values(self) -> tuple[Input, ...]:
        return self.inputs

    @property
    def depends(self) -> frozenset[str]:
        return frozenset(self.of)

    def wrench(self, site: Site, t: Tensor, inputs: Inputs) -> Wrench:
        z = {}
        if self.internal:
            z = {"z": site.internal if site.dt is None else self.advance(site, site.internal, t, inputs, site.dt)}
        return self.function(*self._motion(site), t, **self._given(inputs, t, site), **z)

    def tangent(self, site: Site, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        return super().tangent(site, t, inputs) if self.of else {}

    def rates(self, site: Site, z: Tensor, t: Tensor, inputs: Inputs) -> Tensor:
        """z' (..., internal)."""
        return self.rate(z, *self._motion(site), t, **self._given(inputs, t, site))

    def advance(self, site: Site, z: Tensor, t: Tensor, inputs: Inputs, dt: Tensor) -> Tensor:
        """z (..., internal) at the middle of a step of dt (...) that starts with z; the motion as at its middle."""
        half = (dt / 2)[..., None]
        g = self.rates(site, z, t, inputs)
        (slope,) = jacobians(lambda x: self.rates(site, x, t, inputs), z.expand(*g.shape))
        eye = torch.eye(self.internal, dtype=g.dtype, device=g.device)
        return z + torch.linalg.solve(eye - half[..., None] * slope, (half * g)[..., None])[..., 0]

    def _motion(self, site: Site) -> tuple[Tensor | None, ...]:
        motion = dict(position=site.position, rotation=site.R, velocity=site.velocity, spin=site.spin)
        return tuple(v if name in self.of else None for name, v in motion.items())

    def _given(self, inputs: Inputs, t: Tensor, site: Site) -> Inputs:
        """Inputs by name; along the beam with an axis for the sites."""
        found = {i.name: value_at(i, t, inputs, site.R) for i in self.inputs}
        return found if self.node is not None else {name: v[..., None, :] for name, v in found.items()}
