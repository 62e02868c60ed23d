"""Learning: a policy by gradients through the simulation, and the PD controller's gains by random
search.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

from ..baselines.holding import search
from ..tip_reach import TipReachVectorEnv
from .controllers import PD, Policy
from .episodes import Targets, make, rollout

# of the search: where it starts, and log-normal widths by round
FIRST_GAINS, WIDTHS = (1.0, 3.0, 1.0, 3.0), (1.5, 0.7, 0.35)


def train(
    env: TipReachVectorEnv,
    targets: Targets,
    *,
    updates: int,
    rate: float,
    seed: int,
    progress: Callable[[dict], None],
) -> tuple[Policy, list[dict]]:
    """Analytic policy gradient: ascend the mean return of one whole episode in each sub-env,
    differentiated through every step.

    Adam with a cosine schedule from `rate` to rate/20, gradient norm clipped at 1. Returns the last
    policy and the history.
    """
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        policy = Policy()
    batch = env.num_envs
    optimizer = torch.optim.Adam(policy.parameters(), lr=rate, betas=(0.9, 0.95))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, updates, rate / 20)
    history = []
    for update in range(updates):
        rows = torch.arange(batch) + batch * torch.randint(
            len(targets.seeds) // batch, (batch,), generator=generator
        )
        record = rollout(env, policy, targets.pick(rows))
        loss = -record.reward.mean()
        optimizer.zero_grad()
        loss.backward()
        norm = nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
        if torch.isfinite(norm):
            optimizer.step()
        schedule.step()
        history.append(
            {
                "update": update,
                "return": record.reward.sum(0).mean().item(),
                "final_distance_m": record.final.mean().item(),
                "gradient_norm": norm.item(),
            }
        )
        progress(history[-1])
    return policy, history


@torch.no_grad()
def tune(
    settings: dict, targets: Targets, *, sets: int, seed: int, progress: Callable[[dict], None]
) -> tuple[Tensor, list[dict]]:
    """Gains (1, 4) with the least final distance on the targets: three rounds of `sets` log-normal
    draws, each around the best so far and narrower than the one before; all sets on all targets in
    one batch.
    """
    count, history = len(targets.seeds), []
    every = targets.pick(torch.arange(count).repeat(sets))
    env = make(settings, sets * count)

    def score(gains: Tensor) -> Tensor:
        final = (
            rollout(env, PD(gains.repeat_interleave(count, 0)), every)
            .final.unflatten(0, (sets, count))
            .mean(1)
        )
        history.append(
            {"gains": gains[final.argmin()].tolist(), "final_distance_m": final.min().item()}
        )
        progress(history[-1])
        return final

    best, _ = search(score, FIRST_GAINS, sets=sets, seed=seed, widths=WIDTHS)
    return best[None], history
