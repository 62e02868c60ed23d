"""Cards of the environments, for the site: `python docs/env_cards.py` plays an episode of each task
under a baseline as a small film, in docs/figures/envs, and scores it beside no action, in
docs/results/env_cards (or those tasks that are named).
"""

import argparse
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import torchbeam_envs  # noqa: F401
from PIL import Image
from torchbeam_envs import baselines

from torchbeam.core.results import measured_on, sentence, table, write

ROOT = Path(__file__).parent.parent
FIGURES, RESULTS = ROOT / "docs/figures/envs", ROOT / "docs/results/env_cards"
EPISODES, SEED = 16, 1000
SIZE, COLOURS, PICTURES, SHOWN = (420, 300), 32, 25, 80  # ms a picture
# The baseline of each task: of those without learning and looking ahead the one made for it, with
# its own settings, but for the effort that is best of 0.01 to 10 on episodes of seed 0.
TASKS = {
    "TipReach-v1": baselines.LQR,
    "TipTrack-v1": baselines.LQR,
    "FlutterHold-v1": baselines.LQR,
    "SlewPlanar-v1": partial(baselines.JointLQR, effort=1.0),
    "Payload-v2": baselines.LQR,
    "TwoLink-v1": partial(baselines.JointLQR, effort=0.01),
    "Peg-v1": baselines.Insert,
    "Gripper-v1": baselines.Grasp,
    "FollowTarget-v1": baselines.ResolvedRate,
    "InverseKinematics-v1": baselines.ResolvedRate,
    "ReachObstacles-v0": baselines.ResolvedRate,
    "TrackTarget-v0": partial(baselines.ResolvedRate, gain=0.06, lead=0.1, ahead=0.1),
    "ReachPose-v0": partial(baselines.ResolvedRate, gain=0.03, lead=0.15),
    "ReachBehindNest-v0": partial(baselines.ResolvedRate, gain=0.03, lead=0.15),
}


def scores(task: str, controller: Callable) -> np.ndarray:
    """Returns of held-out episodes (EPISODES,)."""
    env = gymnasium.make_vec(f"torchbeam/{task}", num_envs=EPISODES).unwrapped
    player = controller(env)
    observation, _ = env.reset(seed=SEED)
    player.begin(env)
    total, going = np.zeros(EPISODES), np.ones(EPISODES, bool)
    while going.any():
        observation, reward, ended, cut, _ = env.step(player(observation))
        total += np.where(going, reward, 0)
        going &= ~(ended | cut)
    return total


def film(task: str, controller: Callable, path: Path) -> None:
    """The first of those episodes."""
    env = gymnasium.make_vec(f"torchbeam/{task}", num_envs=1, render_mode="rgb_array").unwrapped
    player = controller(env)
    observation, _ = env.reset(seed=SEED)
    player.begin(env)
    steps = gymnasium.spec(f"torchbeam/{task}").max_episode_steps
    chosen = {*np.linspace(0, steps - 1, PICTURES).round().astype(int).tolist()}
    frames, over, k = [], False, 0
    while not over:
        if k in chosen:
            frames.append(env.render()[0])
        observation, _, ended, cut, _ = env.step(player(observation))
        over, k = bool((ended | cut)[0]), k + 1
    small = [Image.fromarray(frame) for frame in frames]
    for image in small:
        image.thumbnail(SIZE)
    palette = small[-1].quantize(COLOURS)
    first, *rest = (image.quantize(COLOURS, palette=palette, dither=0) for image in small)
    path.parent.mkdir(parents=True, exist_ok=True)
    first.save(path, save_all=True, append_images=rest, duration=SHOWN, loop=0, optimize=True)


def card(task: str, controller: Callable) -> dict:
    """What the card says of a task."""
    env = gymnasium.make_vec(f"torchbeam/{task}", num_envs=1).unwrapped
    returns = {"no action": scores(task, baselines.Zero)}
    returns[getattr(controller, "func", controller).__name__] = scores(task, controller)
    film(task, controller, FIGURES / f"{task}.gif")
    return {
        "observation": int(env.single_observation_space.shape[0]),
        "action": int(env.single_action_space.shape[0]),
        "steps": gymnasium.spec(f"torchbeam/{task}").max_episode_steps,
        "returns": {name: [float(x.mean()), float(x.std())] for name, x in returns.items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", choices=[[], *TASKS], metavar="task")
    names = parser.parse_args().tasks or list(TASKS)
    stored = RESULTS / "env_cards.json"
    cards = json.loads(stored.read_text())["cards"] if stored.exists() else {}
    for name in names:
        since = time.monotonic()
        cards[name] = card(name, TASKS[name])
        print(f"{name}: {cards[name]['returns']}, {time.monotonic() - since:.0f} s", flush=True)
        heading = {**measured_on(), "episodes": EPISODES, "seed": SEED}
        rows = [
            (
                task,
                *(f"{mean:.4g}" for mean, _ in own["returns"].values()),
                list(own["returns"])[-1],
            )
            for task, own in cards.items()
        ]
        head = ("task", "return without action", "with the baseline", "baseline")
        text = f"{table(head, rows, words=1)}\n\n{sentence(heading)}"
        write(RESULTS, "env_cards", text, {**heading, "cards": cards})


if __name__ == "__main__":
    main()
