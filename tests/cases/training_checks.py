"""What learners of either kind are asked alike."""

import pytest
import torch
from torchbeam_envs.baselines import LQR, Zero

from tests.cases.tiny_task import TINY
from training.evaluate import evaluate, make


def check_gradient(objective, weights):
    """The gradient of what weights give against central differences in two directions: 1e-6."""
    gradient = torch.autograd.grad(objective(), weights)
    generator = torch.Generator().manual_seed(1)

    def shifted(direction, step):
        for w, d in zip(weights, direction, strict=True):
            w += step * d

    for _ in range(2):
        direction = [torch.randn(w.shape, generator=generator, dtype=w.dtype) for w in weights]
        slope = sum((g * d).sum() for g, d in zip(gradient, direction, strict=True)).item()
        ends = []
        with torch.no_grad():
            for step in (1e-5, -2e-5):
                shifted(direction, step)
                ends.append(objective().item())
            shifted(direction, 1e-5)
        assert (ends[0] - ends[1]) / 2e-5 == pytest.approx(slope, rel=1e-6)
        assert abs(slope) > 1e-3


def check_lessons(policy):
    """On held-out episodes it loses less than a quarter of what lies between no action and LQR."""
    env = make(TINY, 16)
    idle, taught, teacher = (
        evaluate(TINY, player, 16, env=env)["return"] for player in (Zero(), policy, LQR(env))
    )
    assert teacher - taught < 0.25 * (teacher - idle)
