"""Air of a wing or a blade, by strip theory: each section by its own motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import function_of
from ...core.functions_of_time import taken
from ...core.leaves import Tree, is_function, leaf, option, with_values
from ...core.validation import Value
from ...math.quaternions import skew
from ..beam import Beam
from .drag import norm
from .load_point import (
    ACCELERATION,
    ANGULAR_ACCELERATION,
    INTERNAL,
    POSITION,
    ROTATION,
    SPIN,
    VELOCITY,
    LoadEffect,
    LoadPoint,
    Wrench,
    derivatives,
    jacobians,
)
from .sites import to_sites
from .strip_air_arguments import (
    axes_of,
    chord_along,
    coefficients,
    not_vanishing,
    numbers_along,
    of_place,
    wind_value,
)
from .values import Input, Inputs, value_at
from .wake import Flow, delays
from .wind import in_frame

ROUNDING = 16  # units in the last place of the air along the beam that may be left across it


@dataclass(frozen=True)
class StripAir(LoadEffect):
    """Air about a wing or a blade, by strip theory: each section is a thin aerofoil.

        y of the section
        ^  leading edge            wind -y, nose up = turn about +x (the beam, from the page)
        |  ------o-------- trailing edge
              axis   z is up, lift acts along +z

    The semichord is b, the axis lies a = 2 axis - 1 semichords behind mid-chord. In section axes
    the speed U is toward +y against the air, the upwash w of the air along +z. The pitch rate is p
    about +x, at the beam's axis. Then:

        q = w + b (1/2 - a) p                        upwash at three quarters of the chord
        Q = (1 - sum A_i) q + sum A_i z_i,           z_i' = B_i V/b (q - z_i),  V^2 = U^2 + w^2
        n = rho b c U Q                              normal force of the circulation, at c/4
        f = rho b c (Q - b p/2)^2                    suction of the leading edge, along +y
        l = pi rho b^2 (w' - b a p')                 apparent mass, w' in section axes
        m = b (a + 1/2) n + b a l - pi rho b^3 (U p/2 + b p'/8)

    Force f along y and n + l along z, moment m about x, per metre (Theodorsen 1935, NACA Report
    496; f: Garrick 1936, NACA Report 567; lags: Jones 1940, NACA Report 681). These are the linear
    theory's for small motions. For large ones velocities are resolved in the axes of the deformed
    section. Steady lift is rho b c V^2 sin(alpha), across the air that comes.

    Args:
        chord: m, along y of the section: leading edge at +y, of a negative one at -y. (..., 1) for
            all, (..., N) of the elements, (..., N+1) of the nodes, or a function of s (..., sites).
            It may vanish at a tip, where it counts as 1e-6 of the largest
        axis: of the beam: share of the chord behind the leading edge; likewise
        lift_slope: c, 1/rad; likewise
        polar: function(angle) -> (lift, drag, moment), coefficients by chord and dynamic pressure
            at angles of attack (..., sites) rad, the moment about the quarter chord; in place of
            the lift slope. `Polar` is one, and `DynamicStall`, which has states of its own
        lags: "wagner": two states at each node, A = (0.165, 0.335), B = (0.0455, 0.3); "kussner":
            A = (0.5, 0.5), B = (0.13, 1), for gusts that meet wings which hardly move; pairs
            (A_i, B_i) in their place, () = none, apparent mass alone. None = quasi-steady: Q = q,
            l = p' = 0
        density: (...) kg/m^3 of the air
        wind: m/s, in inertial axes that coincide with frame a at t = 0: (..., 3), a function of t,
            an Input; function(position, t) -> (..., sites, 3), or `Wind`, `Gust`, `Turbulence`,
            `WindTable` and their sums. None = still air
        on: name of a beam of a structure; None = all

    Wind that changes acts by its upwash alone: its own rate does not push. Work of the air is in
    `energy.work`.

    Raises:
        ValueError: for a chord that is 0 everywhere, a negative density, lags that are no such
            pairs, a polar that does not return three coefficients.

    Examples:
        >>> gliding = tb.Scene(beam, [tb.StripAir(0.1, wind=(0, -10.0, 0.5))])
        >>> tb.equilibrium(gliding).tip.position[2] > 0  # lifted
        tensor(True)
    """

    chord: Value | Callable[[Tensor], Tensor] = leaf(1, check=chord_along)
    axis: Value | Callable[[Tensor], Tensor] = leaf(
        1, default=0.25, kw_only=True, check=numbers_along
    )
    lift_slope: Value | Callable[[Tensor], Tensor] = leaf(
        1, default=2 * math.pi, kw_only=True, check=numbers_along
    )
    polar: Callable[[Tensor], Sequence[Tensor]] | None = leaf(
        lambda air: axes_of(air.polar, 0), default=None, kw_only=True, check=function_of("angle")
    )
    lags: str | Sequence[tuple[float, float]] | None = option(
        delays, default="wagner", kw_only=True
    )
    density: Value = leaf(0, default=1.225, kw_only=True, nonnegative=True)
    wind: Value | Input | Callable[..., Tensor] | None = leaf(
        lambda air: 1 if air.wind is None or not air.by_field else axes_of(air.wind, 0),
        default=None, kw_only=True, check=wind_value,
    )  # fmt: skip
    on: str | None = field(default=None, kw_only=True)

    wants_axes = True

    @property
    def internal(self) -> int:
        return len(self.lags or ()) + self._stalls

    @property
    def _stalls(self) -> int:
        """How many states the polar has, of dynamic stall."""
        return getattr(self.polar, "internal", 0)

    @property
    def by_field(self) -> bool:
        """Whether the wind differs from place to place."""
        if isinstance(self.wind, Tree):
            return hasattr(self.wind, "velocity")
        return is_function(self.wind) and of_place(self.wind)

    @property
    def depends(self) -> frozenset[str]:
        carries = () if self.lags is None else (ACCELERATION, ANGULAR_ACCELERATION)
        place = (POSITION,) if self.by_field else ()
        return frozenset({ROTATION, VELOCITY, SPIN, *carries, *place})

    @property
    def by_place(self) -> bool:
        """Whether a number differs along the beam."""
        several = any(callable(x) or x.shape[-1] > 1 for x in self._numbers().values())
        return several or getattr(self.polar, "s", None) is not None

    @property
    def shared(self) -> tuple[str, ...]:
        by_site = getattr(self.polar, "s", None) is not None
        by_site = by_site or getattr(self.polar, "by_site", False)
        return ("density", "wind") if by_site else ("density", "wind", "polar")

    @property
    def simpler(self) -> dict[str, StripAir]:
        less = {} if self.lags is None else {"quasi-steady": replace(self, lags=None)}
        if self._stalls and isinstance(self.polar.polar, Tree):
            less["without dynamic stall"] = replace(self, polar=self.polar.polar)
        return less

    def _numbers(self) -> dict[str, Any]:
        return dict(chord=self.chord, axis=self.axis, lift_slope=self.lift_slope)

    def internal_states(self, beam: Beam) -> int:
        return self.internal * beam.rows_along(self)

    def at_sites(self, s: Tensor, t: Tensor, inputs: Inputs, elements: int) -> StripAir | None:
        if not self.by_place:
            return None
        numbers = {
            name: to_sites(
                f"StripAir's {name}", taken(name, x(s), s) if callable(x) else x, s, elements
            )
            for name, x in self._numbers().items()
        }
        numbers["chord"] = not_vanishing(numbers["chord"])
        if hasattr(self.polar, "at_sites"):
            numbers["polar"] = self.polar.at_sites(s)
        if hasattr(self.wind, "resolved"):
            numbers["wind"] = self.wind.resolved(t, inputs, s)
        elif self.wind is not None and not self.by_field:
            numbers["wind"] = value_at(self.wind, t, inputs, s)
        return with_values(self, **numbers)

    def _placed(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> StripAir:
        """With numbers for the sites of a point; itself where it has them."""
        return self.at_sites(point.s, t, inputs, point.elements) or self

    def wrench(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Wrench:
        here = self._placed(point, t, inputs)
        return _in_frame_a(here._section(here._motion(point, t, inputs), point), point.R)

    def tangent(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        """That of the section's law by the motion x that it reads, in section axes, where a turn s
        of R and a change dv of the velocity give

        d(air) = air x s - dv,    d(e . u) = (e x u) . s + e . du
        """
        here, R = self._placed(point, t, inputs), point.R
        x = here._motion(point, t, inputs)
        (by,) = jacobians(lambda x: here._section(x, point), x)
        none = torch.zeros_like(by[..., :1])
        local = {
            ROTATION: by @ self._turned(point, x),
            VELOCITY: -by[..., :3],
            SPIN: torch.cat((by[..., 3:5], none), -1),
        }
        if self.lags is not None:
            local[ACCELERATION] = torch.cat((none, none, by[..., 5:6]), -1)
            local[ANGULAR_ACCELERATION] = torch.cat((by[..., 6:], none, none), -1)
        if self.by_field:

            def wind(place: Tensor) -> Tensor:
                return here._wind_at(replace(point, position=place), t, inputs) + 0 * place

            (slope,) = jacobians(wind, point.position.expand(*x.shape[:-1], 3))
            local[POSITION] = by[..., :3] @ (R.mT @ slope @ R)
        tangents = {}
        for name, M in local.items():
            M = M @ R.mT
            tangents[name] = torch.cat(
                (R[..., :, 1:] @ M[..., :2, :], R[..., :, :1] @ M[..., 2:, :]), -2
            )
        both = _in_frame_a(here._section(x, point), R)
        turn = torch.cat([skew(w) for w in both], -2)
        return tangents | {ROTATION: tangents[ROTATION] - turn}

    def _motion(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Tensor:
        """What the section's law reads, in section axes (..., sites, 5 or 7): velocity of the air
        against the beam's axis, turning about x and y; with an apparent mass acceleration along z
        and angular acceleration about x, absolute.
        """
        air = self._air(point, t, inputs)
        numbers = [(u * point.R[..., :, k]).sum(-1, keepdim=True) for u, k in self._read(point)]
        return torch.cat((air, *[x.expand(*air.shape[:-1], 1) for x in numbers]), -1)

    def _turned(self, point: LoadPoint, motion: Tensor) -> Tensor:
        """Derivative (..., sites, 5 or 7, 3) of the motion by a turn, section axes."""
        rows = [skew(motion[..., :3])]
        for u, k in self._read(point):
            local = (point.R.mT @ u[..., None])[..., 0].expand(*motion.shape[:-1], 3)
            rows.append(skew(local)[..., k : k + 1, :])
        return torch.cat(rows, -2)

    def _read(self, point: LoadPoint) -> list[tuple[Tensor, int]]:
        """Vectors in frame a, and along which axis of the section they are read."""
        pairs = [(point.spin, 0), (point.spin, 1)]
        if self.lags is not None:
            pairs += [(point.acceleration, 2), (point.angular_acceleration, 0)]
        return [(torch.zeros_like(point.velocity) if u is None else u, k) for u, k in pairs]

    def _section(self, motion: Tensor, point: LoadPoint) -> Tensor:
        """(..., sites, 3) force along y and z and moment about x, per metre, by a motion."""
        flow, a = self._flow(motion), self._behind
        U, _, p, b, _ = flow
        z = point.internal
        z = z if z is None or point.dt is None else self._advanced(z, flow, point.dt)
        suction, normal, moment = self._circulation(flow.delayed(self.lags, z), z)
        apparent = math.pi * self.density[..., None, None] * b**2
        moment = moment + b * (a + 0.5) * normal - apparent * b / 2 * U * p
        if self.lags is not None:
            lift, turning = self._apparent(motion, b, a)
            normal, moment = normal + apparent * lift, moment + apparent * (b * a * lift - turning)
        side = self._side
        return torch.cat(torch.broadcast_tensors(side * suction, normal, side * moment), -1)

    def rates(self, point: LoadPoint, z: Tensor, t: Tensor, inputs: Inputs) -> Tensor:
        """z' (..., sites, internal)."""
        here = self._placed(point, t, inputs)
        flow = here._flow(here._motion(point, t, inputs))
        lags = z[..., : len(self.lags or ())]
        rates = flow.lag_rates(self.lags, lags) * (flow.upwash - lags)
        if not self._stalls:
            return rates
        stall, angle = z[..., lags.shape[-1] :], flow.delayed(self.lags, z).angle
        stall = here.polar.rates(stall, angle, flow.turn) * flow.speed / flow.semichord
        return torch.cat((rates, stall), -1)

    def rates_tangent(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        """Derivative (..., sites, lags, 3 or lags) of z' by names, as in `tangent`, and by z."""
        names = (*sorted(self.depends), INTERNAL)
        return derivatives(lambda at: self.rates(at, at.internal, t, inputs), point, names)

    def advance(self, point: LoadPoint, z: Tensor, t: Tensor, inputs: Inputs, dt: Tensor) -> Tensor:
        """z at the middle of a step of dt (...) that starts with z; the motion as at its middle."""
        here = self._placed(point, t, inputs)
        return here._advanced(z, here._flow(here._motion(point, t, inputs)), dt)

    def _advanced(self, z: Tensor, flow: Flow, dt: Tensor) -> Tensor:
        """z + dt/2 z', z' at mid step."""
        half, lags = dt[..., None, None] / 2, z[..., : len(self.lags or ())]
        h = half * flow.lag_rates(self.lags, lags)
        lags = (lags + h * flow.upwash) / (1 + h)
        if not self._stalls:
            return lags
        stall, angle = z[..., lags.shape[-1] :], flow.delayed(self.lags, lags).angle
        half = (half * flow.speed / flow.semichord)[..., 0]
        return torch.cat((lags, self.polar.advanced(stall, angle, flow.turn, half)), -1)

    def _air(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Tensor:
        """Velocity (..., sites, 3) m/s of the air against the beam's axis, section axes."""
        air = -point.velocity
        if self.wind is not None:
            air = air + self._wind_at(point, t, inputs)
        return (point.R.mT @ air[..., None])[..., 0]

    def _wind_at(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Tensor:
        """(..., sites or 1, 3) m/s, frame a."""
        if not self.by_field:
            return point.from_inertial(value_at(self.wind, t, inputs, point.R))[..., None, :]
        return in_frame(getattr(self.wind, "velocity", self.wind), point, t)

    def _flow(self, motion: Tensor) -> Flow:
        """Without delay. What rounding leaves of air along the beam in the section's plane is none:
        it has no angle, and lags would never come to rest in it.
        """
        along, plane = motion[..., :1], motion[..., 1:3]
        least = (ROUNDING * torch.finfo(plane.dtype).eps * along).square()
        plane = torch.where(plane.square().sum(-1, keepdim=True) > least, plane, 0.0)
        p = self._side * motion[..., 3:4]
        b = self.chord.abs()[..., None] / 2
        q = plane[..., 1:] + b * (0.5 - self._behind) * p
        return Flow(-self._side * plane[..., :1], q, p, b, norm(plane))

    @property
    def _side(self) -> Tensor:
        """1 where the leading edge is at +y of the section, -1 at -y, (..., sites, 1)."""
        return self.chord.sign()[..., None]

    @property
    def _behind(self) -> Tensor:
        """a: semichords from mid-chord back to the beam's axis, (..., sites, 1)."""
        return 2 * self.axis[..., None] - 1

    def _circulation(self, flow: Flow, z: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        """Suction along y and normal force, per metre, and the moment about the quarter chord."""
        U, Q, p, b, _ = flow
        half, w = self.density[..., None, None] * b, Q - b / 2 * p
        if self.polar is None:
            slope = half * self.lift_slope[..., None]
            return slope * w**2, slope * U * Q, torch.zeros_like(Q)
        speed, angle = norm(torch.cat((U, Q), -1)), flow.angle
        stall = self._stalls and z is not None
        of_polar = (
            self.polar.dynamic(angle, z[..., -self._stalls :]) if stall else self.polar(angle)
        )
        lift, drag, moment = (half * speed * x[..., None] for x in coefficients(of_polar, Q))
        return lift * w - drag * U, lift * U + drag * w, 2 * b * speed * moment

    def _apparent(self, motion: Tensor, b: Tensor, a: Tensor) -> tuple[Tensor, Tensor]:
        """w' - b a p' and b^2 p'/8: what the apparent mass pi rho b^2 pushes by, and turns by."""
        along, ahead, _, pitch, yaw, rise, turn = motion.split(1, -1)
        turn = self._side * turn
        return yaw * along - pitch * ahead - rise - b * a * turn, b**2 / 8 * turn


def _in_frame_a(wrench: Tensor, R: Tensor) -> tuple[Tensor, Tensor]:
    """Force and moment of what a section gives: force along y and z, moment about x."""
    y, z, turning = wrench.split(1, -1)
    return y * R[..., :, 1] + z * R[..., :, 2], turning * R[..., :, 0]
