"""A flexible two-link arm, turned by motors in its hinges: LQR, and predictive control that knows
the motors' limits.

`linearize` of the structure about its goal, stretched out at rest, gives the small motions of 28
states from the two torques. Held over 20 ms they give the gain of LQR and, over a horizon of half a
second, the least squares problem of MPC in 50 bounded torques (`lsq_linear`), the last state
weighted by LQR's cost to go. Each controls the full geometrically exact arm, with half as much
payload again as the model has: the two arms are one batch, started at rest from a folded pose.
LQR's torques are clipped, MPC's are within the limits by themselves. CHECK is the RMS distance of
MPC's tip from its goal over the last half second of 2.4, in m. Run as a script, it also draws tips
and torques. Wants scipy (`pip install torchbeam[control]`).
"""

import argparse
import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.linalg import cholesky
from scipy.optimize import lsq_linear

import torchbeam as tb

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--picture", type=Path, default=Path("out/two_link.png"))
options = parser.parse_args(None if __name__ == "__main__" else [])

DT, HORIZON, STEPS, LAST, NEAR = 0.02, 25, 120, 25, 0.02  # s, steps, steps, steps, m
FOLDED, LIMITS = (-0.8, -1.2), np.array([1.0, 0.4])  # rad; N m, of shoulder and elbow
# weights of the angles / rad, the tip's place / m, its speed / (m/s); and of torques / N m, squared
WEIGHTS, EFFORT = (0.5, 0.5, 1.0, 0.2), 0.02


def arm(payload: float, pose: tuple[float, float] | None = None) -> tb.Scene:
    """Two links of 0.5 m on a level table, the motors' torques as inputs; or held in a pose."""
    section = tb.Section.from_stiffness(EA=1e5, GA=4e4, GJ=2.0, EI=3.0, mass=0.2, inertia=1e-5)
    links = {
        "upper arm": tb.Beam.straight(0.5, 2, section),
        "forearm": tb.Beam.straight(0.5, 2, section, root=(0.5, 0, 0)),
    }
    ends = (None, ("upper arm", 0)), (("upper arm", -1), ("forearm", 0))
    motors: list[dict[str, Any]] = (
        [{"torque": tb.Input(name, 1)} for name in ("shoulder", "elbow")]
        if pose is None
        else [{"angle": angle} for angle in pose]
    )
    rotor = dict(inertia=(0.02, 0.02, 0.02))
    return tb.Scene(
        links,
        [
            tb.PointMass(0.0, **rotor, node=("upper arm", 0)),
            tb.PointMass(0.1, **rotor, node=("upper arm", -1)),
            tb.PointMass(payload, node=("forearm", -1)),
            tb.Damping(1e-3),
        ],
        joints=[
            tb.Hinge(*pair, axis=(0, 0, 1), **motor)
            for pair, motor in zip(ends, motors, strict=True)
        ],
        plane="xy",
    )


def inputs(torques: torch.Tensor) -> dict[str, torch.Tensor]:
    """By name, of torques (..., 2) N m."""
    return {"shoulder": torques[..., :1], "elbow": torques[..., 1:]}


model, plant = arm(0.1), arm(0.15)
goal = tb.rest(model)
linear = tb.linearize(
    model,
    goal,
    (
        tb.sensors.JointCoordinate(0),
        tb.sensors.JointCoordinate(1),
        tb.sensors.TipPosition(on="forearm")[1:2],
        tb.sensors.TipVelocity(on="forearm")[1:2],
    ),
    inputs=inputs(torch.zeros(2, dtype=torch.float64)),
).discrete(DT)
A, B, C = (X.numpy() for X in (linear.A, linear.B, linear.C))
W = np.diag(WEIGHTS) @ C  # what is to be small, beside sqrt(EFFORT) u
Q, R = W.T @ W + 1e-8 * np.eye(len(A)), EFFORT * np.eye(2)
P = Q  # z'Pz: LQR's cost to go, by Riccati's recursion (A is stiff: a Schur form is not to be had)
for _ in range(1000):
    K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    P = Q + A.T @ P @ (A - B @ K)
    P = (P + P.T) / 2


def lqr(z: np.ndarray) -> np.ndarray:
    """-K z, clipped."""
    return np.clip(-K @ z, -LIMITS, LIMITS)


class Mpc:
    """The first of the torques within the limits that minimise the cost over the horizon."""

    def __init__(self) -> None:
        powers, free, forced = [np.eye(len(A))], [], []
        for _ in range(HORIZON):
            powers.append(A @ powers[-1])
        weights = [W] * (HORIZON - 1) + [cholesky(P)]
        for k, weight in enumerate(weights, start=1):
            free.append(weight @ powers[k])
            late = [np.zeros_like(B)] * (HORIZON - k)
            forced.append(weight @ np.hstack([powers[k - 1 - j] @ B for j in range(k)] + late))
        self.forced = np.concatenate((*forced, EFFORT**0.5 * np.eye(2 * HORIZON)))
        self.free = np.concatenate((*free, np.zeros((2 * HORIZON, len(A)))))
        self.bounds = -np.tile(LIMITS, HORIZON), np.tile(LIMITS, HORIZON)

    def __call__(self, z: np.ndarray) -> np.ndarray:
        return lsq_linear(self.forced, -self.free @ z, self.bounds, method="bvls").x[:2]


def run(controllers: list) -> tuple[torch.Tensor, torch.Tensor]:
    """Tips from their goal (time, controllers, 3) m and torques (time, controllers, 2) N m."""
    stepper = tb.Stepper(plant, DT, engine="eager")
    folded = tb.equilibrium(arm(0.15, FOLDED), engine="eager")
    state = tb.State.stack([folded for _ in controllers])
    tips, torques = [], []
    for _ in range(STEPS):
        z = linear.departure(state).numpy()
        u = torch.from_numpy(np.stack([c(own) for c, own in zip(controllers, z, strict=True)]))
        state = stepper(state, **inputs(u))
        tips.append(state["forearm"].tip.position - goal["forearm"].tip.position)
        torques.append(u)
    return torch.stack(tips), torch.stack(torques)


NAMES = "MPC", "LQR, clipped"
tips, torques = run([Mpc(), lqr])
errors = torch.linalg.vector_norm(tips, dim=-1)
rms = errors[-LAST:].square().mean(0).sqrt()
CHECK = rms[0].item()
EXPECTED, TOLERANCE = 0.0, 0.005  # half a hundredth of the arm: it has arrived


def settled(error: torch.Tensor) -> float:
    """Seconds until the tip stays near its goal; inf where it does not."""
    outside = (error > NEAR).nonzero().flatten()
    last = int(outside[-1]) + 1 if len(outside) else 0
    return (last + 1) * DT if last < len(error) else math.inf


print(f"{'':<14}{'settled to 20 mm':>18}{'RMS of the last 0.5 s':>24}{'beyond the goal':>18}")
for k, name in enumerate(NAMES):
    print(
        f"{name:<14}{settled(errors[:, k]):>16.2f} s{1e3 * rms[k]:>21.2f} mm"
        f"{1e3 * tips[:, k, 1].max().clamp(min=0):>15.1f} mm"
    )


def draw(path: Path = options.picture) -> None:
    t = DT * torch.arange(1, STEPS + 1, dtype=torch.float64)
    above, below = tb.plot.grid(2, 1, (8, 6))
    for k, (name, color) in enumerate(zip(NAMES, ("C0", "C1"), strict=True)):
        above.plot(t, 1e3 * errors[:, k], color=color, label=name)
        for motor, style in enumerate(("-", "--")):
            label = f"{name}, {('shoulder', 'elbow')[motor]}"
            below.step(t - DT, torques[:, k, motor], style, where="post", color=color, label=label)
    above.set(ylabel="tip from its goal / mm", yscale="log")
    below.set(xlabel="t / s", ylabel="torque / N m")
    above.legend(frameon=False)
    below.legend(frameon=False)
    print("wrote", tb.plot.save(above, path))


if __name__ == "__main__":
    draw()
