"""Films of the published tasks: the first held-out episode of each under a controller of `PLAYERS`,
in space, arm and bars as thick as they are.

    python -m training.films --out docs/figures/published
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from PIL import Image, ImageSequence

import torchbeam as tb
from torchbeam.extend.commands import results_folder

from . import tuned
from .baselines import BASELINES
from .evaluate import make
from .policies import load

POLICIES = Path(__file__).parent / "policies"
# of a film: pictures, how many a second, inches, dots an inch, colours; m, by which it goes beyond
PICTURES, PACE, SIZE, DOTS, COLOURS, ROOM = 36, 9.0, (4.0, 3.6), 75, 64, 0.05
# of each task: the controller that does most, a learned one by its file, and the share of an
# episode that is shown
PLAYERS = {
    "follow-3d": ("shac", 0.25),
    "ik": ("resolved-rate", 0.4),
    "obstacles": ("waypoints", 0.6),
    "obstacles-3d": ("via-point", 1.0),
    "track-target": ("resolved-rate", 0.2),
    "reach-pose": ("resolved-rate", 0.4),
    "reach-behind": ("waypoints", 0.15),
    "reach-nest": ("waypoints", 0.15),
}


GOAL, PRESSED = "#148c46", dict(thickness=0.01, force=1.0)  # nothing is simulated by that
VIEWS = {"obstacles": (12, -80), "reach-behind": (12, -100)}  # degrees


@torch.no_grad()
def played(name: str) -> tuple[Any, tb.State, torch.Tensor, float]:
    """The env of an episode, states of its arm, where the target is then (pictures, 3) m, and the
    time between pictures (s).
    """
    task, (kind, share) = tuned.TASKS[name], PLAYERS[name]
    learned = POLICIES / f"{name}-{kind}.pt"
    controller = load(str(learned)) if learned.exists() else BASELINES[kind](task)
    env = make(task, 1)
    observation, _ = env.reset(seed=tuned.HELD_OUT)
    if hasattr(controller, "begin"):
        controller.begin(env)
    last = round(share * env.config.max_episode_steps)
    shown = {*torch.linspace(0, last, PICTURES).round().int().tolist()}
    states, targets = [], []
    for k in range(last + 1):
        if k in shown:
            states.append(env.state.beam)
            targets.append(env.task.target(env.state)[0, 0])
        observation, *_ = env.step(controller(observation))
    pictures = max(1, len(states) - 1)
    return (
        env,
        type(states[0]).stack(states),
        torch.stack(targets),
        last / pictures * env.config.control_interval,
    )


def solid(env: Any) -> tb.Scene:
    """The arm, as thick as it is, and the bars of the episode."""
    c, task = env.config, env.task
    section = tb.Section.circle(c.radius, c.young, 0.5, c.density)
    root, end = task.usual.nodes[0].tolist(), task.usual.nodes[-1].tolist()
    way = [b - a for a, b in zip(root, end, strict=True)]
    beam = tb.Beam.straight(c.length, c.elements, section, way, root=root)
    bars = task.render_data(env.state).get("bars")
    if hasattr(task, "ends"):  # of a plane, too, where discs are drawn else
        bars = task.ends(env.state).unflatten(-1, (-1, 2, 3))
    bars = () if bars is None else bars[0]
    solid = [tb.Contact(tb.Capsule(a, b, task.bar_radius), **PRESSED) for a, b in bars]
    return tb.Scene(beam, [tb.SelfContact(radius=c.radius, **PRESSED), *solid])  # round, by this


def film(name: str, path: Path) -> None:
    """Written to the path: a GIF."""
    env, states, targets, interval = played(name)
    scene = solid(env)
    root = env.task.usual.nodes[0]
    (ax,) = tb.plot.grid(1, 1, SIZE, three=(0,))
    seen = torch.cat([states.position.flatten(0, -2), targets, root[None]])
    middle, half = (seen.amax(0) + seen.amin(0)) / 2, (seen.amax(0) - seen.amin(0)).max() / 2 + ROOM
    for axis, at in zip("xyz", middle.tolist(), strict=True):
        getattr(ax, f"set_{axis}lim")(at - half.item(), at + half.item())
    ax.view_init(*VIEWS.get(name, (18, -60)))
    goal = ax.plot(*targets[:1].T.tolist(), "o", ms=11, mfc="none", mew=3, color=GOAL, zorder=9)[0]
    time_ = ax.text2D(0.03, 0.95, "", transform=ax.transAxes, family="monospace", fontsize=9)

    def beside(k: int) -> None:
        goal.set_data_3d(*targets[k : k + 1].T.tolist())
        time_.set_text(f"{k * interval:.1f} s")

    path.parent.mkdir(parents=True, exist_ok=True)
    tb.plot.animate(states, path, ax, scene=scene, fps=PACE, dpi=DOTS, trail=False, beside=beside)
    with Image.open(path) as image:
        frames = [frame.convert("RGB") for frame in ImageSequence.Iterator(image)]
    palette = frames[-1].quantize(COLOURS)
    first, *rest = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    each = round(1000 / PACE)
    first.save(path, save_all=True, append_images=rest, duration=each, loop=0, optimize=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Make the films."""
    parser = argparse.ArgumentParser(prog="python -m training.films", description=main.__doc__)
    parser.add_argument("--tasks", nargs="+", choices=PLAYERS, default=[*PLAYERS])
    parser.add_argument("--out", default="out/films", help="%(default)s")
    options = parser.parse_args(argv)
    torch.set_num_threads(1)
    out = results_folder(parser, options.out)
    for name in options.tasks:
        since = time.process_time()
        film(name, out / f"{name}.gif")
        print(f"{name}: {time.process_time() - since:.0f} CPU s", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
