"""Variance of two estimates of a policy's gradient over the horizon, from the same episodes: that
of the return through the simulation, which SHAC uses, and that of likelihood ratios (Williams
1992), which PPO's rests on.

    python -m training.variance --out out/variance
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchbeam.extend.commands import measured_on, results_folder, sentence, table, write_results

from .evaluate import make
from .policies import Policy
from .shac import SHAC, Arguments
from .tuned import SHAC as TUNED
from .tuned import TASKS, TRAINING, Task, task_named

HORIZONS = (2, 4, 8, 16, 32, 64, 100)  # control intervals; an action acts after the first
POLICIES = {"untrained": 0, "trained": 40}  # by updates of SHAC
KINDS = {"simulation": "through the simulation", "likelihood": "likelihood ratios"}
COLORS = {"simulation": "#1b6ca8", "likelihood": "#e08214"}


def gradients(
    task: Task, policy: Policy, horizon: int, repeats: int, episodes: int
) -> dict[str, Tensor]:
    """Name of `KINDS` -> (repeats, parameters): estimates of the gradient, by the weights of the
    policy's network, of the mean return of the first `horizon` intervals, from `episodes` training
    episodes each, other ones each time.

    Likelihood ratios weigh each action by the rewards that follow it, less their mean over the
    other episodes, which leaves the estimate without bias.
    """
    env, weights = make(task, episodes), [*policy.network.parameters()]
    found: dict[str, list[Tensor]] = {name: [] for name in KINDS}
    for repeat in range(repeats):
        seen, _ = env.reset(seed=TRAINING + repeat * episodes)
        noises = torch.Generator().manual_seed(repeat)
        rewards, ratios = [], []
        for _ in range(horizon):
            noise = torch.randn(env.action_space.shape, generator=noises)
            going = ~env.state.done
            features, _ = policy.see(seen, policy.blank(episodes))
            distribution = policy.distribution(features.detach())
            drawn = distribution.mean.detach() + distribution.stddev.detach() * noise
            ratios.append(torch.where(going, distribution.log_prob(drawn).sum(-1), 0.0))
            seen, reward, *_ = env.step(policy.act(features, noise))
            rewards.append(reward)
        rewards, ratios = torch.stack(rewards), torch.stack(ratios)
        follow = rewards.detach().flip(0).cumsum(0).flip(0)
        others = (follow.sum(1, keepdim=True) - follow) / (episodes - 1)
        for name, total in (
            ("simulation", rewards.sum(0)),
            ("likelihood", (ratios * (follow - others)).sum(0)),
        ):
            slopes = torch.autograd.grad(total.mean(), weights, retain_graph=name == "simulation")
            found[name].append(torch.cat([slope.flatten() for slope in slopes]).double())
    return {name: torch.stack(rows) for name, rows in found.items()}


def spread(estimates: dict[str, Tensor]) -> dict[str, dict[str, float | None]]:
    """Name -> variance, summed over the parameters, and `relative`: that over the square of the
    gradient, whose own is taken from the estimates of the least variance, less what variance adds
    to it; None where nothing is left.
    """
    variance = {name: rows.var(0).sum().item() for name, rows in estimates.items()}
    best = min(variance, key=lambda name: variance[name])
    rows = estimates[best]
    square = rows.mean(0).square().sum().item() - variance[best] / len(rows)
    return {
        name: {"variance": value, "relative": value / square if square > 0 else None}
        for name, value in variance.items()
    }


def study(tasks: Sequence[Task], repeats: int, episodes: int) -> list[dict[str, Any]]:
    """A row a task, policy, horizon and estimate."""
    rows = []
    for task in tasks:
        learner, updates = SHAC(task, Arguments(**TUNED.get(task.name, {}))), 0
        for policy, wanted in POLICIES.items():
            while updates < wanted:
                learner.iteration(0.0)
                updates += 1
            for horizon in HORIZONS:
                found = spread(gradients(task, learner.policy, horizon, repeats, episodes))
                rows += [
                    {"task": task.name, "policy": policy, "horizon": horizon, "estimate": name}
                    | values
                    for name, values in found.items()
                ]
    return rows


def picture(rows: list[dict[str, Any]], path: Path) -> None:
    """Relative variance over the horizon, a panel a task; nothing where the gradient is lost."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    tasks = list(dict.fromkeys(row["task"] for row in rows))
    style = {"axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False}
    with plt.rc_context({"font.size": 9, "axes.titlelocation": "left", **style}):
        figure, axes = plt.subplots(
            1, len(tasks), figsize=(4.6 * len(tasks), 3.6), squeeze=False, layout="constrained"
        )
        for ax, task in zip(axes[0], tasks, strict=True):
            for policy, dashes in zip(POLICIES, ("--", "-"), strict=True):
                for name, label in KINDS.items():
                    line = [
                        row
                        for row in rows
                        if (row["task"], row["policy"], row["estimate"]) == (task, policy, name)
                    ]
                    ax.plot(
                        [row["horizon"] for row in line],
                        [row["relative"] or math.nan for row in line],
                        dashes,
                        color=COLORS[name],
                        marker="o",
                        ms=3,
                        label=f"{label}, {policy}",
                    )
            ax.set(
                xscale="log",
                yscale="log",
                title=task,
                xlabel="horizon (control intervals)",
                ylabel="variance over squared gradient",
            )
            ax.xaxis.set_minor_formatter("")
            ax.xaxis.set_major_formatter("{x:g}")
        axes[0, -1].legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
        figure.savefig(path, dpi=120)
        plt.close(figure)


def text(content: dict[str, Any]) -> str:
    """Relative variances as a table, a row a task, policy and horizon."""
    cells: dict[tuple[str, str, str], dict[str, str]] = {}
    for row in content["rows"]:
        place = row["task"], row["policy"], str(row["horizon"])
        relative = row["relative"]
        value = "lost in noise" if relative is None else f"{relative:.3g}"
        cells.setdefault(place, {})[row["estimate"]] = value
    rows = [(*place, *(values[name] for name in KINDS)) for place, values in cells.items()]
    about = (
        f"Variance over squared gradient, from {content['repeats']} estimates of "
        f"{content['episodes']} episodes each."
    )
    head = ("task", "policy", "horizon", *KINDS.values())
    return f"{about}\n\n{table(head, rows, words=2)}\n\n{sentence(content)}"


def main(argv: Sequence[str] | None = None) -> int:
    """Measure both, and write variance.json, variance.csv, variance.md and variance.png."""
    parser = argparse.ArgumentParser(
        prog="python -m training.variance",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--tasks",
        nargs="+",
        choices=TASKS,
        default=["track", "flutter"],
        help="default: %(default)s",
    )
    parser.add_argument(
        "--repeats", type=int, default=24, help="estimates of each (default: %(default)s)"
    )
    parser.add_argument(
        "--episodes", type=int, default=16, help="in an estimate (default: %(default)s)"
    )
    parser.add_argument("--out", default="out/variance", help="default: %(default)s")
    options = parser.parse_args(argv)
    for name in ("repeats", "episodes"):
        if getattr(options, name) < 2:
            parser.error(f"--{name} {getattr(options, name)} was given; at least 2 is wanted")
    out = results_folder(parser, options.out)
    torch.set_num_threads(1)
    rows = study([task_named(name) for name in options.tasks], options.repeats, options.episodes)
    content = {
        **measured_on(dtype=None, threads=1),
        "repeats": options.repeats,
        "episodes": options.episodes,
        "rows": rows,
    }
    values = (row.values() for row in rows)
    write_results(out, "variance", text(content), content, list(rows[0]), values)
    picture(rows, out / "variance.png")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
