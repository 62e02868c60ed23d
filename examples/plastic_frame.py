"""Collapse of a portal frame: plastic hinges form one after another, until it is a mechanism.

The feet are clamped and the frame's five places of the largest moments are elasto-plastic hinges of
the moment M_p. A push P at the left corner and a weight r P in the middle of the beam grow
together. Plastic analysis by virtual work knows three mechanisms (Neal 1977, The Plastic Methods of
Structural Analysis, ch. 3), and the least load is that of collapse:

    sway      P h = 4 M_p        beam  r P l/4 = 2 M_p        both  P h + r P l/2 = 6 M_p

The check is the largest relative error of the loads at which three frames of a batch, of r = 0.5, 2
and 6, go on without more load. Run as a script, it also draws the paths, and a loop of a hinge in a
frame that is pushed to and fro.
"""

import argparse
import math
from pathlib import Path

import torch

import torchbeam as tb

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--picture", type=Path, default=Path("out/plastic_frame.png"))
options = parser.parse_args(None if __name__ == "__main__" else [])

H, L, M_P, EI = 1.0, 1.0, 10.0, 1e4  # m, m, N m, N m^2
RATIO = torch.tensor([0.5, 2.0, 6.0])  # weight over push
SWAY = 0.004  # m, where paths end: it changes the balance by 4e-3

section = tb.Section.from_stiffness(EA=math.inf, GA=math.inf, GJ=EI, EI=EI, mass=1.0)


def bar(start: tuple[float, float], end: tuple[float, float]) -> tb.Beam:
    along = [b - a for a, b in zip(start, end, strict=True)]
    return tb.Beam.straight(
        math.hypot(*along), 1, section, (*along, 0), (0, 0, 1), (*start, 0), order=2
    )


def frame(law: tb.ElastoPlastic | tb.BoucWen, push: tb.Input, weight: tb.Input) -> tb.Scene:
    """Columns and two halves of the beam, with hinges at feet, corners and in the middle."""
    parts = {
        "left": bar((0, 0), (0, H)),
        "first": bar((0, H), (L / 2, H)),
        "second": bar((L / 2, H), (L, H)),
        "right": bar((L, H), (L, 0)),
    }
    ends = [None, *((name, place) for name in parts for place in (0, -1)), None]
    pairs = zip(ends[::2], ends[1::2], strict=True)
    joints = [tb.Hinge(*pair, axis=(0, 0, 1), hysteresis=law) for pair in pairs]
    loads = [tb.PointLoad(("left", -1), force=push), tb.PointLoad(("first", -1), force=weight)]
    return tb.Scene(parts, loads, joints=joints, plane="xy")


def moved(state: tb.State) -> torch.Tensor:
    """How far the corner has gone sideways, and the middle down, together."""
    position, row = state.position, scene.beam.row
    down = H - position[..., row(("first", -1)), 1]
    return position[..., row(("left", -1)), 0] + down


scene = frame(tb.ElastoPlastic(1e3 * EI, M_P), tb.Input("push", 3), tb.Input("weight", 3))
none = torch.zeros_like(RATIO)
loads = {
    "push": torch.stack((none + 1, none, none), -1),
    "weight": torch.stack((none, -RATIO, none), -1),
}
path = tb.path(scene, 100.0, step=0.1, control=moved, target=none + SWAY, inputs=loads)
assert path.reached.all()

mechanisms = {
    "sway": 4 * M_P / (H + 0 * RATIO),
    "beam": 8 * M_P / (RATIO * L),
    "both": 6 * M_P / (H + RATIO * L / 2),
}
exact, which = torch.stack(list(mechanisms.values())).min(0)
CHECK = (path.factor[-1] / exact - 1).abs().max().item()
EXPECTED, TOLERANCE = 0.0, 5e-3  # of the sway at the end

hinges = [tb.sensors.JointHysteresis(k)["variable"] for k in range(len(scene.joints))]
plastic = torch.cat([hinge(path.state[-1]) for hinge in hinges], -1).abs()  # rad
for k, ratio in enumerate(RATIO.tolist()):
    name = list(mechanisms)[which[k]]
    count = int((plastic[k] > 0.1 * plastic[k].max()).sum())
    print(
        f"weight {ratio:.1f} P: collapses at P = {path.factor[-1, k]:.3f} N with {count} hinges; "
        f"mechanism '{name}': {exact[k]:.3f} N"
    )


def pushed(law: tb.ElastoPlastic | tb.BoucWen) -> tuple[list[float], list[float]]:
    """Turn (mrad) and resisting moment (N m) of the left foot, pushed to and fro: each equilibrium
    starts from the last.
    """
    fro, state = frame(law, tb.Input("push", 3), tb.Input("weight", 3)), None
    turns, moments = [], []
    for k in range(1, 73):
        push = torch.tensor([44.0 * math.sin(k * math.pi / 16), 0, 0])
        inputs = {"push": push, "weight": torch.zeros(3)}
        state = tb.equilibrium(fro, initial=state, inputs=inputs)
        turns.append(1e3 * tb.sensors.JointCoordinate(0)(state).item())
        moments.append(-state.joint[0].moment[2].item())
    return turns, moments


def draw(path_to: Path = options.picture) -> None:
    curves, loops = tb.plot.grid(1, 2, (10, 4))
    for k, ratio in enumerate(RATIO.tolist()):
        valid = path.valid[:, k]
        x = 1e3 * moved(path.state)[valid, k]
        curves.plot(x, path.factor[valid, k], "o-", ms=3, color=f"C{k}", label=f"{ratio:g} P")
        curves.axhline(exact[k].item(), color=f"C{k}", lw=0.8, ls="--")
    curves.set(xlabel="sway and sag (mm)", ylabel="push P (N)", xlim=(0, None), ylim=(0, None))
    curves.legend(title="weight", loc="lower right")
    curves.set_title("Three frames, and collapse loads by virtual work")
    stiff = 20 * EI / H
    hardening = tb.ElastoPlastic(stiff, M_P, hardening=0.02 * stiff)
    smooth = tb.BoucWen(stiff, M_P, ratio=0.02, n=2.0)
    loops.plot(*pushed(hardening), lw=1.4, label="ElastoPlastic")
    loops.plot(*pushed(smooth), lw=1.4, label="BoucWen")
    loops.set(xlabel="turn of the left foot (mrad)", ylabel="resisting moment (N m)")
    loops.legend(loc="center")
    loops.set_title("A hinge of a frame that is pushed to and fro")
    print("wrote", tb.plot.save(curves, path_to))


if __name__ == "__main__":
    draw()
