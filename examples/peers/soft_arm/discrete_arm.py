"""The arm of dismech-rl's tasks in a plane, by its publication's own scheme: a discrete elastic rod
(Bergou et al. 2008) whose first edge is held, in implicit Euler steps, written out here.

    python examples/peers/soft_arm/discrete_arm.py [--quick] [--tips]

Prints a row a kind of actions: how far the tip of `FollowTarget-v1`'s arm is from this one's, as a
share of its motion (RMS, and at most). With --tips, the tips of this one.
"""

import json
import math
import sys

import torch
import torchbeam_envs as envs
from torch import Tensor

F64 = torch.float64
EDGES, LENGTH, RADIUS, YOUNG, DENSITY, GRAVITY = 20, 1.0, 0.05, 1e7, 1000.0, 9.8
EDGE, STEP = LENGTH / EDGES, 0.05  # m, s
EA, EI = (YOUNG * math.pi * RADIUS**2 * x for x in (1, RADIUS**2 / 4))
TURNING = (1, 4), (4, 8), (8, 12), (12, 16), (16, 20)  # nodes of each segment, the last left out
KINDS = {  # intervals, steps in each, rad at an action of 1, intervals for which one is held
    "anew in each interval of 0.1 s": (30, 2, 0.05, 1),
    "held for 1 s": (30, 2, 0.05, 10),
    "held for 1 s, intervals of 0.5 s": (12, 10, 0.25, 2),
}
RUNS = 4


def shares() -> Tensor:
    """(segment, node): how a segment's turn is shared by the nodes that are free to turn."""
    made = torch.zeros(len(TURNING), EDGES - 1, dtype=F64)
    for segment, (first, end) in enumerate(TURNING):
        made[segment, first - 1 : end - 1] = 1 / (end - first)
    return made


def mass() -> Tensor:
    """(node,) kg, lumped."""
    made = torch.full((EDGES + 1,), DENSITY * math.pi * RADIUS**2 * EDGE, dtype=F64)
    made[[0, -1]] /= 2
    return made


def energy(free: Tensor, natural: Tensor) -> Tensor:
    """() J of nodes 2 to 20, (38,) m, with natural turns (19,) rad of nodes 1 to 19."""
    x = torch.cat((torch.tensor([[0.0, 0.0], [0.0, EDGE]], dtype=F64), free.reshape(-1, 2)))
    edge = x[1:] - x[:-1]
    long = edge.norm(dim=-1)
    along = edge / long[:, None]
    a, b = along[:-1], along[1:]
    turn = 2 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / (1 + (a * b).sum(-1))  # 2 tan(angle / 2)
    stretched = EA * EDGE / 2 * (long / EDGE - 1).square().sum()
    bent = EI / EDGE / 2 * (turn - natural).square().sum()
    return stretched + bent + GRAVITY * (mass() * x[:, 1]).sum()


gradient = torch.func.vmap(torch.func.grad(energy))
hessian = torch.func.vmap(torch.func.hessian(energy))


def stepped(x: Tensor, v: Tensor, natural: Tensor) -> tuple[Tensor, Tensor]:
    """x (n, 38) m and v (n, 38) m/s at a step's end, by Newton's method to rounding."""
    inertia, ahead = mass()[2:].repeat_interleave(2) / STEP**2, x + STEP * v
    end = ahead
    for _ in range(30):
        residual = inertia * (end - ahead) + gradient(end, natural)
        way = torch.linalg.solve(hessian(end, natural) + torch.diag(inertia), residual)
        end = end - way
        if way.abs().max() < 1e-10:
            return end, (end - x) / STEP
    raise RuntimeError("no solution")


def actions(kind: str) -> Tensor:
    """(interval, run, segment) uniform in [-1, 1]."""
    intervals, _, _, held = KINDS[kind]
    generator = torch.Generator().manual_seed(7)
    drawn = torch.rand(-(-intervals // held), RUNS, len(TURNING), generator=generator, dtype=F64)
    return (2 * drawn - 1).repeat_interleave(held, 0)[:intervals]


def theirs(kind: str) -> Tensor:
    """(interval, run, 2) m: the tip, across and up, at the end of each interval."""
    _, steps, change, _ = KINDS[kind]
    straight = torch.stack((torch.zeros(EDGES - 1), EDGE * torch.arange(2, EDGES + 1)), -1).to(F64)
    x = straight.flatten().repeat(RUNS, 1)
    v, command, tips = torch.zeros_like(x), torch.zeros(RUNS, len(TURNING), dtype=F64), []
    for action in actions(kind):
        after = (command + change * action).clamp(-2, 2)
        for k in range(1, steps + 1):
            x, v = stepped(x, v, (command + k / steps * (after - command)) @ shares())
        command = after
        tips.append(x[:, -2:])
    return torch.stack(tips)


def ours(kind: str) -> Tensor:
    """The same of the environment's arm."""
    _, steps, change, _ = KINDS[kind]
    settings = dict(change=change, control_interval=STEP * steps, substeps=steps)
    env = envs.FollowTargetVectorEnv(
        RUNS, planar=True, output="torch", autoreset_mode="Disabled", **settings
    )
    env.reset(seed=0)
    tips = []
    for action in actions(kind):
        env.step(action)
        tips.append(env.episodes.beam.position[:, -1, [0, 2]].clone())
    return torch.stack(tips)


def compared(kind: str) -> dict[str, object]:
    a, b = ours(kind), theirs(kind)
    apart, moved = (a - b).norm(dim=-1), (b - torch.tensor([0.0, LENGTH], dtype=F64)).norm(dim=-1)
    scale = moved.square().mean().sqrt()
    return {
        "actions": kind,
        "runs": RUNS,
        "motion_rms_m": scale.item(),
        "rms": (apart.square().mean().sqrt() / scale).item(),
        "most": (apart.max() / scale).item(),
    }


if __name__ == "__main__":
    torch.set_num_threads(1)
    kinds = [*KINDS][:1] if "--quick" in sys.argv else [*KINDS]
    for kind in kinds:
        row = (
            {"actions": kind, "tip": theirs(kind).tolist()}
            if "--tips" in sys.argv
            else compared(kind)
        )
        print(json.dumps(row), flush=True)
