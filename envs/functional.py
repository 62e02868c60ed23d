"""Environments as functions: episodes in, episodes out, differentiable, nothing kept and nothing
written in place.

    sim = functional.simulation(torchbeam_envs.TipReachVectorEnv, 16)
    now = functional.reset(sim, seed=0)
    now, reward = functional.step(sim, now, action)
    # now.observation, now.terminated, now.truncated

The same `now` may be stepped any number of times, with other actions: planning, trees, checkpoints
of one's own. `BeamVectorEnv` is these functions behind Gymnasium's interface, with autoreset and
information; `env.simulation` and `env.state` are what they take.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchbeam.extend import count, entry_points, shown

from .accuracy import resolved
from .core import BeamVectorEnv
from .episodes import Episodes
from .simulation import Simulation
from .streams import Streams
from .task import Task

__all__ = ["Simulation", "Transition", "reset", "simulation", "step"]


class Transition(NamedTuple):
    """Result of one control interval: `episodes` after it, and the reward (n,) of it.

    Examples:
        >>> sim = envs.functional.simulation(envs.TipReachVectorEnv, 2, elements=2, planar=True)
        >>> now = envs.functional.reset(sim, seed=0)
        >>> transition = envs.functional.step(sim, now, torch.zeros(2, 1))
        >>> transition.episodes.steps, transition.reward.shape
        (tensor([1, 1]), torch.Size([2]))
    """

    episodes: Episodes
    reward: Tensor


def simulation(of: type[BeamVectorEnv] | type[Task], num_envs: int, **keywords: Any) -> Simulation:
    """A simulation that begins and advances `num_envs` episodes of a task.

    Keywords are those of the task's configuration.

    Raises:
        ValueError: for an object that is neither a vector environment's class nor a task's.
        TypeError: for a keyword that does not exist.

    Examples:
        >>> sim = envs.functional.simulation(envs.TipReachVectorEnv, 2, elements=2, planar=True)
        >>> now = envs.functional.reset(sim, seed=0)
        >>> now.observation.shape
        torch.Size([2, 11])
    """
    count("num_envs", num_envs, 1)
    task = of.task_type if isinstance(of, type) and issubclass(of, BeamVectorEnv) else of
    if not isinstance(task, type) or not issubclass(task, Task):
        raise ValueError(
            f"{shown(of)} was given; a class derived from BeamVectorEnv or from Task is wanted"
        )
    return Simulation(task(resolved(task, task.Config(**keywords))), num_envs)


def reset(
    sim: Simulation, seed: Any = 0, params: Mapping[str, Any] | None = None, goal: Any = None
) -> Episodes:
    """New episodes, the same for the same arguments, as an env's `reset` of this seed begins them.

    Args:
        seed: s gives sub-env i the stream s + i; a sequence gives one each
        params: name -> number or (n,), parameters of these episodes
        goal: (g,) or (n, g), in place of a drawn goal

    Examples:
        >>> sim = envs.functional.simulation(envs.TipReachVectorEnv, 2, elements=2, planar=True)
        >>> now = envs.functional.reset(sim, seed=0)
        >>> torch.equal(now.observation, envs.functional.reset(sim, seed=0).observation)
        True
    """
    _instance("sim", sim, Simulation)
    everyone = torch.ones(sim.count, dtype=torch.bool, device=sim.high.device)
    streams = Streams(sim.count)
    streams.seed(seed, everyone)
    given = sim.options({"params": params, "goal": goal})
    return sim.renew(None, everyone, streams.generators, **given)


def step(sim: Simulation, episodes: Episodes, action: Tensor) -> Transition:
    """One control interval with actions (n, a) in [-1, 1]; actions beyond are clipped.

    Episodes that are over stand still, reward 0.

    Raises:
        ValueError: for actions of another shape or that are no numbers.

    Examples:
        >>> sim = envs.functional.simulation(envs.TipReachVectorEnv, 2, elements=2, planar=True)
        >>> now = envs.functional.reset(sim, seed=0)
        >>> after, reward = envs.functional.step(sim, now, torch.zeros(2, 1))
        >>> now.steps, after.steps
        (tensor([0, 0]), tensor([1, 1]))
    """
    _instance("sim", sim, Simulation)
    _instance("episodes", episodes, Episodes)
    shape = (len(episodes.steps), sim.task.actions)
    if not isinstance(action, Tensor) or action.shape != shape:
        given = (
            f"of shape {tuple(action.shape)}"
            if isinstance(action, Tensor)
            else f"{type(action).__name__}"
        )
        raise ValueError(f"actions {given} were given; a tensor {shape} is wanted")
    if not bool(torch.isfinite(action.detach()).all()):
        raise ValueError(
            "actions that are no finite numbers were given; numbers in [-1, 1] are wanted"
        )
    over = episodes.done
    after, reward, _ = sim.advance(
        episodes, action.to(sim.high).clamp(-1, 1), ~over if bool(over.any()) else None
    )
    return Transition(after, reward)


def _instance(name: str, value: Any, kind: type) -> None:
    if not isinstance(value, kind):
        raise ValueError(f"{name} = {shown(value)} was given; {kind.__name__} is wanted")


entry_points(globals(), __all__)
