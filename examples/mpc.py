"""Model predictive control in real time: Gauss-Newton steps of a nonlinear beam, 50 times a second.

A flexible arm (1 m, EI = 2 N m^2, 0.2 kg/m) on a hub turns in its plane by 60 degrees, by a torque
of at most 0.3 N m. The controller knows a beam of four elements with a payload of 0.1 kg; every 20
ms it improves the torques of the next half second, 25 of them, by one Gauss-Newton step, started
from the plan before, shifted by one, and applies the first. A step is a rollout of the whole
nonlinear model with the derivatives of the tip's place and velocity at all instants by all torques:
`rollout_jacobian`, one call of native code forwards, one backwards. The plant has eight elements
and 0.15 kg. LQR turns the same plant beside it: the gain of `linearize` about the goal, read from
the full state, its torque clipped at the same limit. Both read the plant's state at the nodes that
they know. CHECK is the RMS distance of the tip from its goal over the last half second of three, in
m; `python examples/mpc.py` also draws out/mpc.png.
"""

import math
import time
from dataclasses import replace
from pathlib import Path

import torch

import torchbeam as tb
from torchbeam.extend import quaternions

DT, HORIZON, STEPS, LAST, LIMIT, ANGLE = 0.02, 25, 150, 25, 0.3, math.radians(60)
Z = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
# weights of the tip's place and velocity, squared, at each step and at the last; of the torques
WEIGHT = torch.tensor([1.0, 1.0, 0.02, 0.02], dtype=torch.float64).repeat(HORIZON, 1)
WEIGHT[-1] = torch.tensor([11.0, 11.0, 2.02, 2.02], dtype=torch.float64)
EFFORT = 0.02


def arm(elements: int, payload: float) -> tb.Scene:
    section = tb.Section.from_stiffness(EA=4e3, GA=1.4e3, GJ=0.8, EI=2.0, mass=0.2, inertia=1e-3)
    effects = [
        tb.PointLoad(0, moment=tb.Input("torque", 3)),
        tb.PointMass(0.0, inertia=(0.01, 0.01, 0.02), node=0),
        tb.PointMass(payload),
        tb.Damping(1e-3),
    ]
    hub = tb.Support(0, position="xyz", rotation="xy")
    return tb.Scene(tb.Beam.straight(1.0, elements, section), effects, supports=hub, plane="xy")


def turned(state: tb.State, angle: float) -> tb.State:
    """The whole arm turned about the hub."""
    turn = quaternions.exponential(angle * Z)
    return replace(
        state,
        position=quaternions.rotate(turn, state.position),
        rotation=quaternions.multiply(turn.expand_as(state.rotation), state.rotation),
    )


def known(state: tb.State) -> tb.State:
    """The plant's state at every other node, those of the model; stresses as means."""
    nodes = {
        name: getattr(state, name)[..., ::2, :]
        for name in ("position", "rotation", "velocity", "spin")
    }
    return replace(
        state, **nodes, stress=(state.stress[..., ::2, :] + state.stress[..., 1::2, :]) / 2
    )


model, plant = arm(4, 0.1), arm(8, 0.15)
goal = tb.rest(model)


class Lqr:
    """u = -K z with the state z of the linear model about the goal. The weights are the best of six
    for this turn: heavier ones on the tip's place run into the limit and overshoot.
    """

    def __init__(self) -> None:
        self.linear = tb.linearize(
            model,
            goal,
            (lambda s: s.tip.position, lambda s: s.tip.velocity),
            inputs={"torque": torch.zeros(3, dtype=torch.float64)},
        )
        self.linear = self.linear.discrete(DT)
        A, B, C = self.linear.A, self.linear.B[:, 2:], self.linear.C[1::3]
        Q = C.mT @ torch.diag(
            torch.tensor([10.0, 3.0], dtype=torch.float64)
        ) @ C + 1e-8 * torch.eye(len(A), dtype=torch.float64)
        P = torch.eye(len(A), dtype=torch.float64)
        for _ in range(1000):
            self.K = torch.linalg.solve(B.mT @ P @ B + 10.0, B.mT @ P @ A)
            P = Q + A.mT @ P @ (A - B @ self.K)
            P = (P + P.mT) / 2

    def __call__(self, state: tb.State) -> float:
        return -(self.K @ self.linear.departure(state)).item()


def read(states: tb.State) -> torch.Tensor:
    """(..., 4): the tip's place (m) and velocity (m/s) in the plane."""
    return torch.cat((states.position[..., -1, :2], states.velocity[..., -1, :2]), -1)


def least(linear: torch.Tensor, matrix: torch.Tensor) -> torch.Tensor:
    """The torques u within the limit at which linear'u + u'matrix u / 2 is least: which of them are
    at it, and on which side, is found in a few rounds (a primal-dual active set).
    """
    side = torch.zeros(HORIZON, dtype=torch.float64)
    for _ in range(30):
        u, free = LIMIT * side, side == 0
        u[free] = -torch.linalg.solve(matrix[free][:, free], (linear + matrix @ u)[free])
        pushed = side * (linear + matrix @ u) < 0  # outward, those at the limit
        before, side = side, torch.where(free, u.sign() * (u.abs() > LIMIT), side * pushed)
        if side.equal(before):
            break
    return u.clamp(-LIMIT, LIMIT)


class Mpc:
    """Torques of the next half second, improved at each call; seconds: what each took."""

    def __init__(self) -> None:
        self.stepper, self.plan = tb.Stepper(model, DT), torch.zeros(HORIZON, dtype=torch.float64)
        self.seconds: list[float] = []
        self(goal)  # compiles
        self.plan, self.seconds = torch.zeros(HORIZON, dtype=torch.float64), []

    def __call__(self, state: tb.State) -> float:
        begin = time.perf_counter()
        torques = torch.cat((self.plan[1:], self.plan[-1:])).requires_grad_()
        inputs = {"torque": tb.PerInterval(torques[:, None] * Z)}
        tips, slopes = tb.rollout_jacobian(self.stepper, state, HORIZON, inputs, read, torques)
        J, torques = slopes.flatten(0, 1), torques.detach()
        weighted = (WEIGHT[..., None] * slopes).flatten(0, 1)
        gradient = weighted.mT @ (tips - read(goal)).flatten() + EFFORT * torques
        matrix = J.mT @ weighted + EFFORT * torch.eye(HORIZON, dtype=torch.float64)
        self.plan = least(gradient - matrix @ torques, matrix)
        self.seconds.append(time.perf_counter() - begin)
        return self.plan[0].item()


def run(control) -> tuple[torch.Tensor, torch.Tensor]:
    """Distances of the tip from its goal (m) and torques (N m) at each step."""
    stepper, state = tb.Stepper(plant, DT), turned(tb.rest(plant), -ANGLE)
    errors, torques = [], []
    for _ in range(STEPS):
        torque = min(max(control(known(state)), -LIMIT), LIMIT)
        state = stepper(state, torque=torque * Z)
        errors.append((state.tip.position - goal.tip.position).norm())
        torques.append(torch.tensor(torque, dtype=torch.float64))
    return torch.stack(errors), torch.stack(torques)


mpc = Mpc()
controllers = {"MPC": mpc, "LQR, clipped": Lqr()}
found = {name: run(control) for name, control in controllers.items()}
CHECK = found["MPC"][0][-LAST:].square().mean().sqrt().item()
EXPECTED, TOLERANCE = 0.0, 0.01  # 1 % of the arm: it has arrived


def settled(errors: torch.Tensor, within: float = 0.02) -> float:
    """Seconds until the tip stays within so many m of its goal; inf where it does not."""
    outside = (errors > within).nonzero().flatten()
    last = int(outside[-1]) + 1 if len(outside) else 0
    return (last + 1) * DT if last < len(errors) else math.inf


print(f"{'':<14}{'settled to 20 mm':>18}{'RMS of the last 0.5 s':>24}{'largest torque':>17}")
for name, (errors, torques) in found.items():
    print(
        f"{name:<14}{settled(errors):>16.2f} s{1e3 * errors[-LAST:].square().mean().sqrt():>21.2f} "
        f"mm{torques.abs().max():>13.2f} N m"
    )
seconds = torch.tensor(mpc.seconds, dtype=torch.float64)
print(
    f"a plan (a Gauss-Newton step on {HORIZON} torques) took {1e3 * seconds.median():.1f} ms, "
    f"{1e3 * seconds.quantile(0.95):.1f} ms at most in 95 of 100; one is due every {1e3 * DT:.0f} "
    "ms"
)


def draw(path: Path = Path("out/mpc.png")) -> None:
    t = DT * torch.arange(1, STEPS + 1, dtype=torch.float64)
    above, below = tb.plot.grid(2, 1, (8, 6))
    for name, (errors, torques) in found.items():
        above.plot(t, 1e3 * errors, label=name)
        below.step(t - DT, torques, where="post", label=name)
    above.set(ylabel="tip from its goal / mm", yscale="log")
    below.set(xlabel="t / s", ylabel="torque / N m")
    above.legend(frameon=False)
    print("wrote", tb.plot.save(above, path))


if __name__ == "__main__":
    draw()
