"""A strip that loses a quarter of its stiffness while it moves, seen by two accelerometers.

A force at the tip shakes it; the sensors read the mean acceleration over each interval, with noise
and an offset. An extended Kalman filter (`tb.KalmanFilter`) estimates the motion, the offsets and
the stiffness, which it is told may drift. The check is the stiffness a second after the change. Run
as a script, it also draws the stiffness with its 95 % interval, and the tip, which nothing reads.
The film: the estimate (orange) covers the strip (blue); the stiffness is found anew in 0.3 s.
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
    "--picture", type=Path, default=Path("out/changing_stiffness.png"), help="the film is beside it"
)
options = parser.parse_args(None if __name__ == "__main__" else [])

DT, READINGS, CHANGE = 0.01, 250, 150  # s; the change is after so many
BEFORE, AFTER = 1.0, 0.75  # of the nominal stiffness
NOISE, OFFSETS = 0.2, (0.1, -0.15)  # m/s^2
TIP = tb.sensors.NodeVelocity(-1)["z"]
SENSORS = [tb.sensors.NodeVelocity(2)["z"], TIP]


def strip(p: dict[str, torch.Tensor]) -> tb.Scene:
    """An aluminium strip, 0.6 m, clamped, with a force at its tip."""
    section = tb.Section.rectangle(0.03, 0.002, E=69e9 * p["E"], nu=0.33, rho=2700.0)
    beam = tb.Beam.straight(0.6, 4, section)
    return tb.Scene(beam, [tb.TipLoad(force=tb.Input("push", 3)), tb.Damping(1e-3)], plane="xz")


def push(k: int) -> tuple[float, float, float]:
    """N, over the k-th interval."""
    return 0.0, 0.0, 0.4 * math.sin(16.0 * k * DT) * math.cos(5.0 * k * DT)


nominal = strip({"E": torch.tensor(1.0, dtype=torch.float64)})
stiffness = tb.Parameter(1.0, transform="log", prior=torch.distributions.LogNormal(0.0, 0.1))
f = tb.KalmanFilter(
    strip,
    SENSORS,
    dt=DT,
    rate=True,
    noise=NOISE,
    bias=0.2,
    parameters={"E": stiffness},
    walk={"E": 0.1},  # of its logarithm, in a second
    process={"push": (0.0, 0.0, 0.01)},
    model=tb.linearize(nominal, inputs={"push": (0.0, 0.0, 0.0)}).reduced(3),
)

random = torch.Generator().manual_seed(0)
state, z = tb.rest(nominal), f.start()
mean, low, high, tips, shapes = [], [], [], [], []
for k in range(READINGS):
    if k in (0, CHANGE):
        factor = BEFORE if k == 0 else AFTER
        step = tb.Stepper(strip({"E": torch.tensor(factor, dtype=torch.float64)}), DT)
    before = torch.cat([sensor(state).flatten() for sensor in SENSORS])
    state = step(state, push=push(k))
    after = torch.cat([sensor(state).flatten() for sensor in SENSORS])
    noise = NOISE * torch.randn(2, generator=random, dtype=torch.float64)
    z = f(z, (after - before) / DT + torch.tensor(OFFSETS) + noise, push(k))
    mean.append(z.unknown["E"].item())
    ends = z.interval("E").tolist()
    low.append(ends[0])
    high.append(ends[1])
    tips.append([state.tip.position[2].item(), z.state.tip.position[2].item()])
    shapes.append(tb.State.stack([state, z.state]))

truth, seen = torch.tensor(tips).unbind(-1)
CHECK, EXPECTED, TOLERANCE = mean[-1], AFTER, 0.03
OFF = ((seen - truth).square().mean() / truth.square().mean()).sqrt().item()  # of the tip's motion


def draw(path: Path) -> None:
    t = DT * torch.arange(1, READINGS + 1)
    above, below = tb.plot.grid(2, 1, (7, 5))
    above.plot(t, [BEFORE if k < CHANGE else AFTER for k in range(READINGS)], "k--", label="truth")
    above.plot(t, mean, "C0", label="estimate")
    above.fill_between(t, low, high, color="C0", alpha=0.25, label="95 % interval")
    above.set_ylabel("stiffness over nominal")
    above.legend()
    below.plot(t, 1e3 * truth, "k--", label="truth")
    below.plot(t, 1e3 * seen, "C0", label="estimate")
    below.set_ylabel("tip, mm")
    below.set_xlabel("s")
    below.legend()
    tb.plot.save(above, path, dpi=120)


def film(path: Path) -> None:
    """Every fourth reading, at half the motion's speed."""
    left, right = tb.plot.grid(1, 2, (8, 3.2))
    left.set(xlim=(0, 0.64), ylim=(-0.12, 0.12))
    t = DT * torch.arange(1, READINGS + 1)
    right.plot(t, [BEFORE if k < CHANGE else AFTER for k in range(READINGS)], "k--", label="truth")
    (line,) = right.plot([], [], "C1", label="estimate")
    right.set(xlim=(0, DT * READINGS), ylim=(0.6, 1.2), xlabel="s", title="stiffness over nominal")
    right.legend(loc="lower left")
    every = range(3, READINGS, 4)
    tb.plot.animate(
        tb.State.stack([shapes[k] for k in every]),
        path.with_suffix(".gif"),
        left,
        fps=12.5,
        dpi=70,
        trail=False,
        beside=lambda i: line.set_data(t[: every[i] + 1], mean[: every[i] + 1]),
    )


if __name__ == "__main__":
    print(f"stiffness over nominal: {mean[CHANGE - 1]:.3f} before, {CHECK:.3f} after the change")
    print(
        f"95 % interval at the end: {low[-1]:.3f} to {high[-1]:.3f}; tip off by {100 * OFF:.0f} %"
    )
    draw(options.picture)
    film(options.picture)
    print(f"picture and film: {options.picture}, .gif")
