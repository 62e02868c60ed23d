"""A wind turbine's rotor: power over tip-speed ratio, how its blades bend, and how air damps them.

Three blades of 50 m whose chord and twist are near Glauert's optimum at a tip-speed ratio of 7.
Blade-element momentum theory with Prandtl's losses gives power and thrust of forty speeds in one
batch. At the best of them a blade is a beam in a frame that turns: `StripAir` meets the wind and
what the theory says that the rotor induces. The root of a stiff blade bears the theory's thrust and
torque; a flexible one bends and twists. Three of them on a hub that turns, in the same wind and
induction at all speeds, have modes that the air damps: flap much, lag (edge) little. Run as a
script, it also draws out/wind_turbine.png and out/wind_turbine_modes.png.
"""

import math
from pathlib import Path

import torch

import torchbeam as tb

HUB, TIP, WIND, DENSITY, BLADES, N = 2.0, 50.0, 10.0, 1.225, 3, 12
RATIO, DESIGN = 7.0, torch.tensor(6.0).deg2rad()  # tip-speed ratio, angle of attack there
AXIS = (0.0, 0.0, 1.0)  # along the wind

alpha = torch.deg2rad(torch.arange(-10.0, 17.0))
lift = 6.0 * (alpha + 0.03) - 20.0 * torch.relu(alpha - 0.17) ** 2
foil = tb.Polar(alpha, lift, 0.008 + 0.25 * (alpha - 0.05) ** 2).extended(aspect_ratio=15.0)

s = torch.linspace(0, TIP - HUB, N + 1)  # m, of the nodes along a blade
r = HUB + s
local = RATIO * r / TIP
phi = 2 / 3 * torch.atan(1 / local)  # Glauert 1935, with swirl
twist = phi - DESIGN
chord = 8 * torch.pi * r * (1 - phi.cos()) / (BLADES * foil(DESIGN[None])[0])
chord = torch.minimum(chord, 0.09 * TIP - 0.05 * s)
inside = torch.cat((r[:1] + 1e-4, r[1:-1], r[-1:] - 1e-4))  # where losses are not whole


def rotor(ratio):
    """The rotor at tip-speed ratios (...)."""
    return tb.blade_element_momentum(
        WIND, ratio * WIND / TIP, inside, chord, twist, foil,
        blades=BLADES, hub=HUB, tip=TIP, axis=AXIS, density=DENSITY,
    )  # fmt: skip


def blade(stiffness, elements, angle=0.0, on=None):
    """A blade at an azimuth, rad, whose section has so many times its stiffness; and its air."""
    section = tb.Section.from_stiffness(
        EA=stiffness * 3e9, GA=stiffness * 1e9, GJ=stiffness * 4e8,
        EI=(stiffness * 8e8, stiffness * 3e9), mass=250.0, inertia=(20.0, 80.0),
    )  # fmt: skip
    out = torch.tensor((math.cos(angle), math.sin(angle), 0.0))
    place = dict(root=HUB * out, direction=out, up=AXIS)
    beam = tb.Beam.straight(TIP - HUB, elements, section, twist=tb.Table(s, -twist), **place)
    met = tb.Wind((0, 0, WIND)) + best.induction
    strips = dict(axis=0.25, polar=foil, density=DENSITY, lags=None, wind=met)
    return beam, tb.StripAir(tb.Table(s, chord), **strips, on=on)


def turning(stiffness):
    """Thrust N and torque N m of three blades whose section has so many times its stiffness, and
    how far their tips bend downwind, m.
    """
    beam, air = blade(stiffness, N)
    spin = tb.Frame(angular_velocity=(0, 0, speed))
    state = tb.equilibrium(tb.Scene(beam, [air], frame=spin))
    torque = state.root.moment[2] + HUB * state.root.force[1]
    return -BLADES * state.root.force[2], -BLADES * torque, state.tip.position[2]


def standing():
    """The rotor as seen from the ground: three flexible blades on a hub with a bearing."""
    parts, air = {"hub": tb.Body(mass=5e4, inertia=1e5)}, []
    joints = [tb.Hinge(None, "hub", axis=AXIS)]
    for k in range(BLADES):
        name = f"blade {k}"
        parts[name], strips = blade(1.0, N, 2 * math.pi * k / BLADES, name)
        air.append(strips)
        joints.append(tb.Weld("hub", (name, 0)))
    return tb.Scene(parts, air, joints=joints)


ratios = torch.linspace(3.0, 12.0, 40)
all_speeds = rotor(ratios)
power = all_speeds.torque * ratios * WIND / TIP
share = power / (DENSITY / 2 * torch.pi * TIP**2 * WIND**3)
k = int(share.argmax())
speed = ratios[k] * WIND / TIP
best = rotor(ratios[k])
stiff_thrust, stiff_torque, _ = turning(1e5)
thrust, torque, bend = turning(1.0)
speeds = torch.linspace(0.5, 1.75, 11) * speed
modes = tb.campbell(standing(), speeds, count=6)
CHECK = max(
    abs(x / y - 1).item() for x, y in ((stiff_thrust, best.thrust), (stiff_torque, best.torque))
)
EXPECTED, TOLERANCE = 0.0, 2e-4

print(f"largest power {100 * share[k]:.1f} % of the wind's (Betz: 59.3 %), at {ratios[k]:.1f}")
print(f"theory         thrust {best.thrust / 1e3:.1f} kN   torque {best.torque / 1e3:.1f} kN m")
print(f"stiff blades          {stiff_thrust / 1e3:.1f}             {stiff_torque / 1e3:.1f}")
print(f"flexible ones         {thrust / 1e3:.1f}             {torque / 1e3:.1f}")
print(f"their tips bend {bend:.2f} m downwind")
print(modes)


def draw(path: Path = Path("out/wind_turbine.png")) -> None:
    import matplotlib.pyplot as plt

    _, (left, right) = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained")
    area = DENSITY / 2 * torch.pi * TIP**2 * WIND**2
    left.plot(ratios, share, label="power")
    left.plot(ratios, all_speeds.thrust / area, label="thrust")
    left.axhline(16 / 27, color="k", lw=0.8, ls="--", label="Betz's limit of power")
    left.set(xlabel="tip-speed ratio", title="coefficients of the rotor", ylim=(0, 1.1))
    left.legend()
    right.plot(r, best.elements.axial, label="axial factor")
    right.plot(r, best.elements.swirl, label="swirl factor")
    right.plot(r, best.elements.loss, label="loss at tip and hub", lw=1, ls="--")
    right.set(xlabel="radius, m", title=f"at a ratio of {ratios[k]:.1f}", ylim=(0, 1.1))
    right.legend()
    print("wrote", tb.plot.save(left, path))
    left, right = tb.plot.grid(1, 2, (10, 4))
    modes.plot(left, damping=right)
    print("wrote", tb.plot.save(left, path.with_name("wind_turbine_modes.png")))


if __name__ == "__main__":
    draw()
