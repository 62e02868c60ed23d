"""A task of training that takes no time: an episode of twelve intervals of two elements."""

from training.tuned import Task

TINY = Task(
    "tiny",
    "torchbeam/TipReachPlanar-v1",
    dict(elements=2, substeps=1, max_episode_steps=12, control_interval=0.05),
)
SHORT = Task(
    "tiny", "torchbeam/TipReachPlanar-v1", dict(elements=2, substeps=1, max_episode_steps=6)
)
