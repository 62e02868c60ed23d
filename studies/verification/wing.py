"""Flutter of Goland's wing: strip theory with Wagner's lag, written as a user's `Load`.

Thin airfoil theory (Theodorsen 1935) on every section, with the semichord b, the elastic axis a b
behind mid-chord, the speed U along the chord, the velocity w and the acceleration w' of the elastic
axis along the section's normal and the pitch rate p:

    lift    pi rho b^2 (-w' + U p - b a p') + 2 pi rho U b Q
    moment  pi rho b^2 (-b a w' - U b (1/2 - a) p - b^2 (1/8 + a^2) p') + 2 pi rho U b^2 (a + 1/2) Q

Q is the downwash at three quarters of the chord, q = -w + b (1/2 - a) p with -w = U alpha - h' for
small angles, after Wagner's function 1 - A_1 exp(-B_1 U t/b) - A_2 exp(-B_2 U t/b) as R. T. Jones
has it (NACA Report 681, 1940): two states at each node,

    Q = (1 - A_1 - A_2) q + A_1 z_1 + A_2 z_2        z_i' = B_i U/b (q - z_i)
"""

from __future__ import annotations

import math
from functools import cache

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import quaternions

from .case import Case

A, B = (0.165, 0.335), (0.0455, 0.3)
# half span and chord, m; elastic axis and centre of mass, of the chord
SPAN, CHORD, AXIS, CENTRE = 6.096, 1.8288, 0.33, 0.43
EI, GJ, MASS, INERTIA = 9.77e6, 0.987e6, 35.72, 8.64  # N m^2; kg/m; kg m about the elastic axis
DENSITY = 1.225  # kg/m^3, sea level
N = 16
# the same equations in the frequency domain, 5 bending and 5 torsion modes
GALERKIN = (137.34673, 69.33932)


def strips(chord: float | Tensor, speed: Tensor, a: float, density: float) -> tb.Load:
    """Air that comes along -y of frame a at `speed` (...) m/s, on a wing whose leading edge is in
    +y of its sections.
    """

    def downwash(
        R: Tensor, v: Tensor, w: Tensor, b: Tensor, speed: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """U, q and p (..., sites, 1)."""
        wind = torch.stack((torch.zeros_like(speed), -speed, torch.zeros_like(speed)), -1)
        _, U, normal = (R.mT @ (v - wind)[..., None])[..., 0].split(1, -1)
        p = (w * R[..., 0]).sum(-1, keepdim=True)
        return U, b * (0.5 - a) * p - normal, p

    def rate(
        z: Tensor, _: None, R: Tensor, v: Tensor, w: Tensor, t: Tensor, **of: Tensor
    ) -> Tensor:
        b = of["semichord"][..., None]
        U, q, _ = downwash(R, v, w, b, of["speed"])
        return z.new_tensor(B) * U / b * (q - z)

    def load(
        _: None, R: Tensor, v: Tensor, w: Tensor, t: Tensor, **of: Tensor
    ) -> tuple[Tensor, Tensor]:
        b, z = of["semichord"][..., None], of["z"]
        U, q, p = downwash(R, v, w, b, of["speed"])
        delayed = (1 - sum(A)) * q + (z * z.new_tensor(A)).sum(-1, keepdim=True)
        lagged = 2 * math.pi * density * U * b * delayed
        rise, turn = (
            (of[name] * R[..., k]).sum(-1, keepdim=True)
            for name, k in (("acceleration", 2), ("angular_acceleration", 0))
        )
        apparent = math.pi * density * b**2
        lift = apparent * (-rise + U * p - b * a * turn) + lagged
        moment = (
            -apparent * b * (a * rise + U * (0.5 - a) * p + b * (1 / 8 + a**2) * turn)
            + b * (a + 0.5) * lagged
        )
        return lift * R[..., 2], moment * R[..., 0]

    return tb.Load(
        load, node=None, internal=2, rate=rate,
        values={"semichord": chord / 2, "speed": speed[..., None]},
        of=("rotation", "velocity", "spin", "acceleration", "angular_acceleration"),
    )  # fmt: skip


def goland(speed: Tensor, elements: int = N, GJ: float | Tensor = GJ) -> tb.Scene:
    """The wing at speeds (...) m/s: nodes on the elastic axis, x along the span, y forward."""
    offset = quaternions.skew(torch.tensor([0.0, (AXIS - CENTRE) * CHORD, 0.0]))
    inertia = torch.diag(torch.tensor([INERTIA, 0.01 * INERTIA, INERTIA]))
    mass = torch.cat((
        torch.cat((MASS * torch.eye(3), -MASS * offset), -1),
        torch.cat((MASS * offset, inertia), -1),
    ), -2)  # fmt: skip
    zero = torch.zeros(())
    section = tb.Section(
        torch.diag(torch.stack((zero, zero, zero, 1 / (zero + GJ), zero + 1 / EI, zero))), mass
    )
    air = strips(CHORD, speed, 2 * AXIS - 1, DENSITY)
    return tb.Scene(tb.Beam.straight(SPAN, elements, section), [air])


@cache
def flutter() -> tuple[Tensor, Tensor]:
    """Speed m/s and frequency rad/s."""
    critical = tb.critical_load(goland, 170.0, lowest=110.0, points=5, count=4)
    return critical.factor, critical.frequency


JONES = (
    "Jones's lags for Theodorsen's function: 3e-3 of the speed, 1e-2 of the frequency, by "
    "the same equations with either"
)
SOURCE, MESH = "Goland and Luke 1948", f"{N} elements"
NAME = "Goland's wing, unsteady strip theory"
CASES = [
    Case(NAME, SOURCE, "flutter speed, m/s", MESH, lambda: (flutter()[0], torch.tensor(137.2)),
         3e-3, JONES),
    Case(NAME, SOURCE, "flutter frequency, rad/s", MESH,
         lambda: (flutter()[1], torch.tensor(70.7)), 2e-2,
         f"{JONES}; 1e-2 of it the published figure's own"),
    Case(NAME, "the same equations in the frequency domain, 1e-6", "flutter speed and frequency",
         MESH, lambda: (torch.stack(flutter()), torch.tensor(GALERKIN)), 5.2e-4),
]  # fmt: skip
