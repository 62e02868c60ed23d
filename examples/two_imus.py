"""A soft arm that tendons bend, whose tip is known by two inertial sensors alone.

One sits in the middle, one at the tip; each shows its inclination, with noise and an offset of a
degree, and its turn rate, with noise. The rubber is softer than it is taken for, and a gust that
nobody measures pushes the arm. An extended Kalman filter (`tb.KalmanFilter`) estimates the motion,
the stiffness, the offsets and the push. The check is how far the estimated tip is off, as a share
of its motion, in the second half. Run as a script, it also draws the tip and the stiffness.
The film: the estimate (orange) covers the arm (blue), and the gust is seen that nobody measures.
"""

import argparse
import math
from pathlib import Path

import torch

import torchbeam as tb

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument(
    "--picture", type=Path, default=Path("out/two_imus.png"), help="the film is beside it"
)
options = parser.parse_args(None if __name__ == "__main__" else [])

DT, READINGS, GUST = 0.02, 150, (70, 95)  # s; the gust blows in these intervals
LENGTH, RADIUS, OFFSET = 0.25, 0.006, 0.012  # m
SOFTER, PUSHED = 0.85, 0.02  # of the nominal stiffness; N at the tip
ANGLE, RATE = math.radians(0.5), 0.02  # rad, rad/s: noise
OFFSETS = torch.tensor([1.0, 0.0, -1.0, 0.0], dtype=torch.float64).deg2rad()
beam = tb.Beam.straight(
    LENGTH, 4, tb.Section.circle(RADIUS, E=2e6, nu=0.45, rho=1100.0), (0, 0, -1), (0, 1, 0)
)
# axes of the hanging arm, from which an inclination counts
STRAIGHT = tb.sensors.NodeRotation(0)(tb.rest(tb.Scene(beam)))
SENSORS = [
    part
    for node in (2, -1)
    for part in (
        tb.sensors.Angles(node, STRAIGHT, kind="vector")["z"],
        tb.sensors.Spin(node, body=True)["z"],
    )
]
NOISE = torch.tensor([ANGLE, RATE] * 2, dtype=torch.float64)


def arm(p: dict[str, torch.Tensor]) -> tb.Scene:
    """It hangs; a tendon on each side, and a force that may push the tip."""
    section = tb.Section.circle(RADIUS, E=2e6 * p["E"], nu=0.45, rho=1100.0)
    rod = tb.Beam.straight(LENGTH, 4, section, (0, 0, -1), (0, 1, 0))
    tendons = [
        tb.Tendon.along(rod, (0.0, side * OFFSET, 0.0), tension=tb.Input(name, 1))
        for name, side in (("left", 1), ("right", -1))
    ]
    push = tb.TipLoad(force=tb.Input("push", 3))
    return tb.Scene(rod, [*tendons, push, tb.Gravity((0, 0, -9.81)), tb.Damping(0.02)], plane="xz")


def tensions(k: int) -> dict[str, list[float]]:
    """N, over the k-th interval: the arm swings from side to side."""
    bend = math.sin(3.0 * k * DT) * min(1.0, k * DT)
    return {"left": [0.6 + 0.5 * bend], "right": [0.6 - 0.5 * bend]}


still = {**tensions(0), "push": (0.0, 0.0, 0.0)}
nominal = arm({"E": torch.tensor(1.0, dtype=torch.float64)})
law = torch.distributions.LogNormal(0.0, 0.15)
f = tb.KalmanFilter(
    arm,
    SENSORS,
    dt=DT,
    noise=NOISE,
    bias=[math.radians(1.0), 0.0] * 2,
    parameters={"E": tb.Parameter(1.0, transform="log", prior=law)},
    process={"push": ((PUSHED, 0.0, 0.0), 0.3)},
    model=tb.linearize(nominal, inputs=still).reduced(6),
)

random = torch.Generator().manual_seed(0)
step = tb.Stepper(arm({"E": torch.tensor(SOFTER, dtype=torch.float64)}), DT)
state, z = tb.equilibrium(step.scene, inputs=still), f.start()
mean, low, high, tips, pushes, shapes = [], [], [], [], [], []
for k in range(READINGS):
    gust = PUSHED if GUST[0] <= k < GUST[1] else 0.0
    pulled = {name: torch.tensor(pull, dtype=torch.float64) for name, pull in tensions(k).items()}
    state = step(state, **pulled, push=(gust, 0.0, 0.0))
    y = torch.cat([sensor(state).flatten() for sensor in SENSORS]) + OFFSETS
    z = f(z, y + NOISE * torch.randn(4, generator=random, dtype=torch.float64), pulled)
    mean.append(z.unknown["E"].item())
    ends = z.interval("E").tolist()
    low.append(ends[0])
    high.append(ends[1])
    tips.append([state.tip.position[0].item(), z.state.tip.position[0].item()])
    pushes.append([1e3 * gust, 1e3 * z.unknown["push[0]"].item()])
    shapes.append(tb.State.stack([state, z.state]))

truth, seen = torch.tensor(tips, dtype=torch.float64).unbind(-1)
late = slice(READINGS // 2, None)
OFF = (seen - truth)[late].square().mean().sqrt().item()  # m
CHECK = OFF / (truth[late] - truth[late].mean()).square().mean().sqrt().item()
EXPECTED, TOLERANCE = 0.0, 0.01


def draw(path: Path) -> None:
    t = DT * torch.arange(1, READINGS + 1)
    above, middle, below = tb.plot.grid(3, 1, (7, 7))
    above.plot(t, 1e3 * truth, "k--", label="truth")
    above.plot(t, 1e3 * seen, "C0", label="estimate")
    above.set_ylabel("tip, mm")
    above.legend()
    middle.axhline(SOFTER, color="k", linestyle="--")
    middle.plot(t, mean, "C0")
    middle.fill_between(t, low, high, color="C0", alpha=0.25, label="95 % interval")
    middle.set_ylabel("stiffness over nominal")
    middle.legend()
    for column, style in zip(zip(*pushes, strict=True), ("k--", "C0"), strict=True):
        below.plot(t, column, style)
    below.set_ylabel("push at the tip, mN")
    below.set_xlabel("s")
    tb.plot.save(above, path, dpi=120)


def film(path: Path) -> None:
    """Every second reading, at half the motion's speed."""
    left, right = tb.plot.grid(1, 2, (8, 4))
    left.set(xlim=(-0.15, 0.15), ylim=(-0.27, 0.02))
    t = DT * torch.arange(1, READINGS + 1)
    columns = list(zip(*pushes, strict=True))
    right.plot(t, columns[0], "k--", label="truth")
    (line,) = right.plot([], [], "C1", label="estimate")
    right.set(xlim=(0, DT * READINGS), ylim=(-15, 35), xlabel="s", title="push at the tip, mN")
    right.legend(loc="upper left")
    every = range(1, READINGS, 2)
    tb.plot.animate(
        tb.State.stack([shapes[k] for k in every]),
        path.with_suffix(".gif"),
        left,
        fps=12.5,
        dpi=70,
        trail=False,
        beside=lambda i: line.set_data(t[: every[i] + 1], columns[1][: every[i] + 1]),
    )


if __name__ == "__main__":
    print(f"tip off by {1e3 * OFF:.1f} mm RMS, {100 * CHECK:.1f} % of its motion")
    print(
        f"stiffness {mean[-1]:.3f} of the nominal ({low[-1]:.3f} to {high[-1]:.3f}); it is {SOFTER}"
    )
    draw(options.picture)
    film(options.picture)
    print(f"picture and film: {options.picture}, .gif")
