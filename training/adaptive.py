"""What estimation is worth at the uncertain level, and what could be had at most.

python -m training.adaptive --episodes 16

By task on the first held-out episodes: MPC by the usual plant, LQR and MPC by what a filter makes
of the readings, MPC that knows the plant but sees it through the readings (the bound), and MPC that
knows and sees all.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from torchbeam_envs.baselines import LQR, MPC, AdaptiveMPC, Controller, Estimated, JointLQR

from torchbeam.extend.commands import measured_on, sentence, table

from .evaluate import evaluate, make
from .options import above_zero
from .tuned import NOMINAL, TASKS

CONTROLLERS: dict[str, Callable[[Any], Controller]] = {
    "MPC, usual plant": MPC,
    "Estimated(LQR)": lambda env: Estimated((LQR if env.task.HOLDS else JointLQR)(env)),
    "AdaptiveMPC": AdaptiveMPC,
    "bound": lambda env: AdaptiveMPC(env, known=True),
    "MPC, informed": lambda env: MPC(env, informed=True),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Score controllers that estimate, and the bound, at the uncertain level."""
    parser = argparse.ArgumentParser(prog="python -m training.adaptive", description=main.__doc__)
    parser.add_argument("--tasks", nargs="+", choices=NOMINAL, default=NOMINAL)
    parser.add_argument("--controllers", nargs="+", choices=CONTROLLERS, default=[*CONTROLLERS])
    parser.add_argument("--episodes", type=above_zero(int), default=16, metavar="N")
    given = parser.parse_args(argv)
    rows = []
    for name in given.tasks:
        task = TASKS[f"{name}-uncertain"]
        for title in given.controllers:
            env = make(task, given.episodes)
            begin = time.process_time()
            score = evaluate(task, CONTROLLERS[title](env), given.episodes, env=env)
            spent = time.process_time() - begin
            shares = f"{100 * score['success']:.0f}", f"{100 * score['within']:.0f}"
            told = (f"{score['return']:.2f}", *shares, f"{score['ended']}", f"{spent:.0f}")
            rows.append((name, title, *told))
            print(*rows[-1], file=sys.stderr, flush=True)
    head = ("task", "controller", "return", "success, %", "within, %", "lost", "CPU s")
    print(f"{given.episodes} held-out episodes of the uncertain level.\n")
    print(table(head, rows, words=2))
    print(f"\n{sentence(measured_on())}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
