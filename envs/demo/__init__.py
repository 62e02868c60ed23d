"""A flexible aluminium strip learns to reach, from gradients through its own simulation.

Task: `torchbeam/TipReach-v1`. The strip is 1.5 m of 6061-T6 flat bar, 3 mm x 10 mm, clamped at one
end, under gravity; a tip force of up to 1.2 N sideways and 2 N up and down brings the tip to a
target within 1 s, which is about one period of the first mode (1.1 Hz), and holds it there. It acts
one control interval (20 ms) after it was decided. 3 mm x 10 mm, rather than a wider strip, because
a force in two directions should move the tip in both: by 0.6 m and by 0.1 m.

A small network is trained by the gradient of the return through whole episodes, on strips up to 15
% stiffer or softer so that it does not lean on the model's highest modes, and compared, on targets
it has not seen, with doing nothing, with the static holding force, and with a PD controller whose
gains are tuned on training targets of the very strip it is judged on. All but the first are given
the holding force of the target, found by `torchbeam.equilibrium`; the PD controller and the network
add feedback to it. The best two are judged once more on a finer model, which neither has seen.

The final distance is the mean over the last 0.2 s; the settling time is when the tip comes within 2
% of the length for good (the whole episode if it never does); the effort is the root mean square of
the tip force.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from contextlib import contextmanager
from pathlib import Path

import torch

from torchbeam.extend.commands import measured_on, results_folder, save, write

TASK = dict(elements=4, substeps=2, control_interval=0.02, max_episode_steps=50)
FULL = dict(
    task=TASK,
    rounds=16,
    batch=32,
    spread=0.15,
    updates=40,
    rate=1.5e-2,
    pd_targets=16,
    pd_sets=40,
    held_out=256,
    finer=64,
    stride=1,
)
QUICK = dict(
    task={**TASK, "elements": 2, "substeps": 1, "max_episode_steps": 30},
    rounds=2,
    batch=8,
    spread=0.15,
    updates=5,
    rate=1.5e-2,
    pd_targets=4,
    pd_sets=6,
    held_out=16,
    finer=4,
    stride=15,
)
FINER = dict(elements=8, substeps=4)
TRAINING, HELD_OUT = 1_000_000, 2_000_000  # first seeds, far apart


def main(argv: Sequence[str] | None = None) -> int:
    """Train a controller of a flexible strip by gradients, and show what it learned."""
    options = parse(argv)
    try:
        import matplotlib  # noqa: F401
        import PIL  # noqa: F401
        import tqdm  # noqa: F401
    except ImportError as error:
        raise SystemExit(f"the demo wants {error.name}: pip install 'torchbeam[demo]'") from None
    torch.set_num_threads(options.threads)
    out = options.out
    result, records = run(QUICK if options.quick else FULL, options.seed, out)
    from .figures import animation, picture

    check = {
        f"{name}, finer model": s
        for name, s in result["scores_on_finer_model"].items()
        if name != "model"
    }
    scores = table({**result["scores"], **check})
    print(f"{scores}\n\n{result['sentence']}")
    write(out / "demo.md", f"{result['sentence']}\n\n{scores}\n")
    with timed(result["seconds"], "pictures"):
        picture(records, result, out / "demo.png")
        animation(records, out / "demo.gif", result["settings"]["stride"])
    write(out / "demo.json", json.dumps(result, indent=2) + "\n")
    print(
        f"{', '.join(f'{name} {value:.0f} s' for name, value in result['seconds'].items())}; "
        f"written to {out}: demo.md, demo.png, demo.gif, demo.json, policy.pt"
    )
    return 0


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m torchbeam demo",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/demo"),
        help="folder for the results (default: %(default)s)",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="some seconds on a coarse strip: everything runs, little is learned",
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="of targets, network and search (default: %(default)s)"
    )
    parser.add_argument(
        "--threads",
        type=int,
        default=1,
        help="of torch; tensors are small, and on a busy machine 2 are much slower (default: "
        "%(default)s)",
    )
    options = parser.parse_args(argv)
    if options.threads < 1:
        parser.error(f"--threads {options.threads} was given; at least 1 is wanted")
    options.out = results_folder(parser, options.out)
    return options


def run(settings: dict, seed: int, out: Path) -> tuple[dict, dict]:
    """Everything but the pictures: (what goes into the JSON, the records of the held-out episodes
    by controller).
    """
    from tqdm import tqdm

    from .controllers import PD, nothing, static
    from .episodes import Targets, evaluate, make, varied
    from .learning import train, tune

    seconds: dict[str, float] = {}
    task = settings["task"]
    with timed(seconds, "targets"):
        env = make(
            {**task, "section": varied(settings["batch"], settings["spread"])}, settings["batch"]
        )
        pool = Targets.of(env, TRAINING + 10_000 * seed, settings["rounds"])
        few = Targets.of(make(task, settings["pd_targets"]), TRAINING + 10_000 * seed)
        judge = make(task, settings["held_out"])
        unseen = Targets.of(judge, HELD_OUT + 10_000 * seed)
        finer_judge = make({**task, **FINER}, settings["finer"])
        finer = Targets.of(finer_judge, HELD_OUT + 10_000 * seed)

    with (
        timed(seconds, "training"),
        tqdm(total=settings["updates"], desc="learning", unit="update") as bar,
    ):

        def learned(entry: dict) -> None:
            bar.set_postfix_str(f"final distance {1e3 * entry['final_distance_m']:.2f} mm")
            bar.update()

        policy, history = train(
            env,
            pool,
            updates=settings["updates"],
            rate=settings["rate"],
            seed=seed,
            progress=learned,
        )
    save(out / "policy.pt", policy.state_dict())

    with timed(seconds, "tuning PD"), tqdm(total=3, desc="tuning PD", unit="round") as bar:
        gains, search = tune(
            task, few, sets=settings["pd_sets"], seed=seed, progress=lambda entry: bar.update()
        )

    controllers = {
        "nothing": nothing,
        "static force": static,
        "PD + static force": PD(gains),
        "learned": policy,
    }
    with timed(seconds, "evaluation"):
        records = {
            name: evaluate(judge, one, unseen)
            for name, one in tqdm(controllers.items(), desc="evaluating", unit="controller")
        }
        check = {
            name: evaluate(finer_judge, controllers[name], finer).scores()
            for name in ("PD + static force", "learned")
        }
    steps = {
        "learned": settings["updates"] * settings["batch"],
        "PD": 3 * settings["pd_sets"] * settings["pd_targets"],
    }
    scores = {name: record.scores() for name, record in records.items()}
    return {
        "sentence": sentence(scores, settings["held_out"]),
        "scores": scores,
        "scores_on_finer_model": {"model": FINER, **check},
        "learning": history,
        "pd_search": search,
        "training_episodes": steps,
        "settings": settings,
        "seed": seed,
        **measured_on(),
        "seconds": seconds,
    }, records


def sentence(scores: dict[str, dict], targets: int) -> str:
    """What is seen, in one sentence."""
    (far, long), (pd_far, pd_long) = (
        (1e3 * scores[name]["final_distance_m"], scores[name]["settling_time_s"])
        for name in ("learned", "PD + static force")
    )
    return (
        f"Over {targets} unseen targets the learned controller ends {far:.2f} mm from the target, "
        f"settled after {long:.2f} s; the tuned PD controller {pd_far:.2f} mm, after "
        f"{pd_long:.2f} s (means)."
    )


def table(scores: dict[str, dict]) -> str:
    """One row a controller, in Markdown."""
    lines = [
        f"| {'controller':<30} | final distance | within 2 % of L | effort (rms) | settling time |",
        f"|{'-' * 32}|---------------:|----------------:|-------------:|--------------:|",
    ]
    for name, s in scores.items():
        lines.append(
            f"| {name:<30} | {1e3 * s['final_distance_m']:>11.2f} mm | "
            f"{100 * s['share_within_2_percent']:>13.1f} % | {s['effort_N']:>10.2f} N | "
            f"{s['settling_time_s']:>11.2f} s |"
        )
    return "\n".join(lines)


@contextmanager
def timed(seconds: dict[str, float], name: str):
    start = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - start
