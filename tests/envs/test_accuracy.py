"""Elements and substeps of an env by the accuracy that is wanted."""

import torch
import torchbeam_envs as envs
from torchbeam_envs import functional

from tests.cases.refusals import refusals

ACTIONS = 2 * torch.rand(50, 1, 2, generator=torch.Generator().manual_seed(1)) - 1


def path(**made):
    """Of the tip (time, 3), under the same actions, from rest."""
    sim = functional.simulation(envs.SlewVectorEnv, 1, planar=True, delay=0, **made)
    now, way = functional.reset(sim), []
    for action in ACTIONS.to(now.beam.position.dtype):
        now, _ = functional.step(sim, now, action)
        way.append(now.beam.position[0, -1])
    return sim.config, torch.stack(way)


def test_the_tip_is_known_to_it():
    """Under other actions than those by which the mesh was chosen, against eight times the nodes
    and substeps.
    """
    config, way = path(accuracy=3e-2)
    assert config.accuracy is None and config.elements >= 4
    fine = dict(elements=8 * config.elements, substeps=8 * config.substeps)
    _, limit = path(**fine)
    _, coarse = path(elements=2, substeps=1)
    size = (limit - limit[0]).norm()
    assert (way - limit).norm() / size <= 3e-2 < (coarse - limit).norm() / size
    # chosen anew, by times measured anew: another mesh, or the same
    chosen = envs.SlewVectorEnv(1, planar=True, accuracy=3e-2).config
    assert chosen.accuracy is None
    _, way = path(elements=chosen.elements, substeps=chosen.substeps)
    assert (way - limit).norm() / size <= 3e-2


@refusals(
    (envs.SlewVectorEnv, dict(accuracy=0.0), "accuracy = 0"),
    (envs.FollowTargetVectorEnv, {}, "FollowTarget, whose actions belong to elements"),
    (envs.TipReachVectorEnv, dict(form="minimal", method="rk4", gravity=None), "form = "),
)
def test_refusals(env, given):
    env(1, **{"accuracy": 1e-2, **given})
