"""A flexible arm that turns on a motor with a payload of unknown mass, which is weighed on the way.

The hinge's angle and one strain gauge are read, with noise and an offset of the gauge; the torque
is known up to 20 mNm. An extended Kalman filter (`tb.KalmanFilter`) estimates the motion and the
mass. The check is the mass at the end. Run as a script, it also draws the mass with its 95 %
interval, and the tip's deflection, which nothing reads.
The film: the estimate (orange) covers the arm (blue), and the mass comes out of its bending.
"""

import argparse
import math
from pathlib import Path

import torch

import torchbeam as tb
from torchbeam.extend import quaternions

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument(
    "--picture", type=Path, default=Path("out/slewing_payload.png"), help="the film is beside it"
)
options = parser.parse_args(None if __name__ == "__main__" else [])

DT, READINGS = 0.01, 150  # s
MASS, FIRST, SPREAD = 0.14, 0.1, 0.4  # kg: the true one, what it is taken for, and its deviation
NOISE = torch.tensor([2e-3, 5e-6], dtype=torch.float64)  # rad; strain
OFFSET, SHAKEN = 1e-5, 0.02  # strain; Nm
section = tb.Section.rectangle(0.03, 0.002, E=69e9, nu=0.33, rho=2700.0)
beam = tb.Beam.straight(0.6, 3, section)
SENSORS = [tb.sensors.JointCoordinate(0), tb.sensors.Gauge(0.1, beam, z=0.001, on="arm")]


def arm(p: dict[str, torch.Tensor]) -> tb.Scene:
    """An aluminium strip on a motor, with a payload at its tip."""
    motor = tb.Hinge(None, ("arm", 0), axis=(0, 1, 0), torque=tb.Input("motor", 1), damping=0.01)
    loads = [tb.PointMass(p["mass"], node=("arm", -1)), tb.Damping(1e-3)]
    return tb.Scene({"arm": beam}, loads, joints=[motor], plane="xz")


def torque(k: int) -> float:
    """Nm, over the k-th interval: the arm turns and comes back to rest."""
    return 0.12 * math.sin(2 * math.pi * k / READINGS)


def deflection(state: tb.State) -> float:
    """Of the tip across the direction in which the arm begins, m."""
    root, tip = state.position[0], state.position[-1]
    across = quaternions.rotate(state.rotation[0], torch.tensor([0.0, 0.0, 1.0]).to(root))
    return ((tip - root) * across).sum().item()


nominal = arm({"mass": torch.tensor(FIRST, dtype=torch.float64)})
law = torch.distributions.LogNormal(math.log(FIRST), SPREAD)
f = tb.KalmanFilter(
    arm,
    SENSORS,
    dt=DT,
    noise=NOISE,
    bias=(0.0, 2 * OFFSET),
    parameters={"mass": tb.Parameter(FIRST, transform="log", prior=law)},
    process={"motor": SHAKEN},
    model=tb.linearize(nominal, inputs={"motor": (0.0,)}).reduced(5),
)

random = torch.Generator().manual_seed(1)
step = tb.Stepper(arm({"mass": torch.tensor(MASS, dtype=torch.float64)}), DT)
state, z = step.rest(), f.start()
mean, low, high, tips, shapes = [], [], [], [], []
for k in range(READINGS):
    shaken = SHAKEN * torch.randn(1, generator=random, dtype=torch.float64)
    state = step(state, motor=torque(k) + shaken)
    y = torch.cat([sensor(state).flatten() for sensor in SENSORS])
    y = y + NOISE * torch.randn(2, generator=random, dtype=torch.float64)
    y[1] += OFFSET
    z = f(z, y, {"motor": [torque(k)]})
    mean.append(z.unknown["mass"].item())
    ends = z.interval("mass").tolist()
    low.append(ends[0])
    high.append(ends[1])
    tips.append([deflection(state), deflection(z.state)])
    shapes.append(tb.State.stack([state, z.state]))

CHECK, EXPECTED, TOLERANCE = mean[-1], MASS, 0.01
truth, seen = torch.tensor(tips).unbind(-1)
CURVES = ("C1", "estimate"), ("C1:", "95 % interval"), ("C1:", None)


def draw(path: Path) -> None:
    t = DT * torch.arange(1, READINGS + 1)
    above, below = tb.plot.grid(2, 1, (7, 5))
    above.axhline(1e3 * MASS, color="k", linestyle="--", label="truth")
    above.plot(t, [1e3 * m for m in mean], "C0", label="estimate")
    ends = ([1e3 * m for m in side] for side in (low, high))
    above.fill_between(t, *ends, color="C0", alpha=0.25, label="95 % interval")
    above.set_ylabel("payload, g")
    above.legend()
    below.plot(t, 1e3 * truth, "k--", label="truth")
    below.plot(t, 1e3 * seen, "C0", label="estimate")
    below.set_ylabel("deflection of the tip, mm")
    below.set_xlabel("s")
    below.legend()
    tb.plot.save(above, path, dpi=120)


def film(path: Path) -> None:
    """Every third reading, at 0.4 of the motion's speed."""
    left, right = tb.plot.grid(1, 2, (8, 4))
    left.set(xlim=(-0.05, 0.65), ylim=(-0.5, 0.1))
    t = DT * torch.arange(1, READINGS + 1)
    right.axhline(1e3 * MASS, color="k", linestyle="--", label="truth")
    lines = [right.plot([], [], style, label=label)[0] for style, label in CURVES]
    right.set(xlim=(0, DT * READINGS), ylim=(0, 350), xlabel="s", title="payload, g")
    right.legend()
    every = range(2, READINGS, 3)

    def show(i: int) -> None:
        for line, values in zip(lines, (mean, low, high), strict=True):
            line.set_data(t[: every[i] + 1], [1e3 * m for m in values[: every[i] + 1]])

    motion = tb.State.stack([shapes[k] for k in every])
    gif = path.with_suffix(".gif")
    tb.plot.animate(motion, gif, left, fps=13, dpi=70, trail=False, beside=show)


if __name__ == "__main__":
    for k in (9, 49, READINGS - 1):
        print(f"after {DT * (k + 1):.1f} s: {1e3 * mean[k]:.0f} g ({1e3 * low[k]:.0f} to "
              f"{1e3 * high[k]:.0f}), truth {1e3 * MASS:.0f}")  # fmt: skip
    draw(options.picture)
    film(options.picture)
    print(f"picture and film: {options.picture}, .gif")
