"""Films of the published tasks, for the site: `python docs/published_films.py` plays the first
held-out episode of each task under the best controller there is (or of those tasks that are named),
in space, the arm and the bars as thick as they are, in docs/figures/published.
"""

import argparse
from pathlib import Path
from typing import Any

import matplotlib
import torch
from PIL import Image

import torchbeam as tb
from training import tuned
from training.baselines import BASELINES
from training.evaluate import make
from training.policies import load
from training.published import PUBLISHED

ROOT = Path(__file__).parent.parent
FIGURES, POLICIES = ROOT / "docs/figures/published", ROOT / "training/policies"
PICTURES, PACE, SIZE, DOTS = 40, 10.0, (4.2, 3.6), 75  # of a film: pictures, 1/s, inches, 1/inch
COLOURS = 32
# the learned policies that are kept are the best; else of these, by the table
LED = {"obstacles": "waypoints", "reach-behind": "waypoints"}
SHOWN = {"ik": 0.4, "obstacles": 0.6, "obstacles-3d": 0.8, "reach-pose": 0.4}  # of an episode
ROUND = 12  # bars end so, of as many sides


def player(name: str, task: tuned.Task) -> Any:
    """The controller of a film."""
    kept = POLICIES / f"{name}-shac.pt"
    if name not in LED and kept.exists():
        return load(str(kept))
    return BASELINES[LED.get(name, "resolved-rate")](task)


@torch.no_grad()
def played(name: str) -> tuple[Any, torch.Tensor, torch.Tensor, float]:
    """Of an episode: the env, states of the arm (pictures,), places of the target (pictures, 3) m,
    and the time between pictures (s).
    """
    task = tuned.TASKS[name]
    env, controller = make(task, 1), player(name, task)
    observation, _ = env.reset(seed=tuned.HELD_OUT)
    if hasattr(controller, "begin"):
        controller.begin(env)
    last = round(SHOWN.get(name, 0.3) * env.config.max_episode_steps)
    at = {*torch.linspace(0, last, PICTURES).round().int().tolist()}
    states, targets = [], []
    for k in range(last + 1):
        if k in at:
            states.append(env.state.beam)
            targets.append(env.task.target(env.state)[0, 0])
        observation, *_ = env.step(controller(observation))
    return env, states, torch.stack(targets), last / PICTURES * env.config.control_interval
