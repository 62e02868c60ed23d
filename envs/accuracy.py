"""Elements and substeps of a task by the accuracy that is wanted."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import partial

import torch

import torchbeam as tb
from torchbeam.extend import METHODS

from .config import BeamEnvConfig
from .task import Task

INTERVALS = 50  # of the motion that is looked at, at most: an episode is that, or longer


def resolved(task: type[Task], config: BeamEnvConfig) -> BeamEnvConfig:
    """The configuration with the elements and substeps by which the tip's path is known to
    `config.accuracy`, see `torchbeam.converge`: over an episode from rest at the usual parameters,
    actions drawn evenly for each interval. As it is where no accuracy is asked for.

    Warns (RuntimeWarning) where the accuracy was not reached. Raises ValueError for a task whose
    actions are no inputs of a scene on every mesh, a beam of one mesh, and explicit methods.
    """
    if config.accuracy is None:
        return config
    wanted = config.accuracy
    for given, what in (
        (not task.MESHED, f"{task.__name__}, whose actions belong to elements"),
        (config.beam is not None, "beam, whose mesh is its own"),
        (
            config.form != "nodal" or config.method not in METHODS,
            f"form = {config.form!r} and method = {config.method!r}",
        ),
    ):
        if given:
            raise ValueError(
                f"accuracy with {what} was given; elements and substeps are wanted in its place"
            )
    plain = replace(config, accuracy=None)

    def made(elements: int) -> Task:
        return task(replace(plain, elements=elements))

    usual = made(plain.elements)
    count = min(config.max_episode_steps or INTERVALS, INTERVALS)
    source = torch.Generator().manual_seed(0)
    drawn = torch.rand(count, usual.actions, generator=source, dtype=torch.float64)
    actions = (2 * drawn - 1).to(usual.dtype).to(usual.device)
    inputs = usual.inputs(actions)
    still = {name: torch.zeros_like(x[:1]) for name, x in inputs.items()}
    best = tb.converge(
        lambda elements, order: made(elements).usual_scene(),
        config.control_interval * torch.arange(count + 1, dtype=torch.float64),
        lambda solution: solution.state.position[..., -1, :],
        wanted,
        elements=["linear"],
        methods=[config.method],
        initial=partial(tb.equilibrium, inputs=still) if usual.settles else None,
        inputs={name: tb.PerInterval(x[None]) for name, x in inputs.items()},
        engine=config.engine,
    )
    if not best.converged:
        warnings.warn(
            f"accuracy = {wanted:g} was not reached: {' '.join(best.notes)}",
            RuntimeWarning,
            stacklevel=4,
        )
    substeps = round(config.control_interval / best.settings.step)
    return replace(plain, elements=best.settings.elements, substeps=substeps)
