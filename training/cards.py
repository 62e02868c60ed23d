"""The policies of a study that are kept, and what is to be known of them.

python -m training.cards docs/results/learning     # its SHAC policies, into training/policies
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .policies import load
from .table import label

KEPT = Path(__file__).parent / "policies"


def policies(out: Path, runs: list[dict[str, Any]]) -> None:
    """Copy the policies of the first seed whose file is there (not of the best seed) with their
    scores, and their cards.
    """
    folder, scores = out / "policies", {}
    for run in sorted(runs, key=lambda run: run["seed"] or 0):
        source = out / "runs" / f"{run['task']}-{run['algorithm']}-{run['seed']}.pt"
        name = f"{run['task']}-{run['algorithm']}.pt"
        if source.exists() and name not in scores:
            folder.mkdir(exist_ok=True)
            shutil.copyfile(source, folder / name)
            scores[name] = {
                key: value for key, value in run.items() if key not in ("cpu_minutes_all", "budget")
            }
    if scores:
        (folder / "scores.json").write_text(json.dumps(scores, indent=2) + "\n")
        (folder / "README.md").write_text(cards(folder))


def cards(folder: Path) -> str:
    """What is to be known of the policies in a folder, from their files, a row each."""
    lines = [
        "# Policies",
        "",
        "Networks of the first seed of each study whose file was kept, not of the best, for the "
        "plants that they were trained on and the observation of their task: elsewhere nothing is "
        "known of them but what stands under *outside*. `training.policies.load` reads them, "
        "`python -m training.evaluate FILE` makes the scores again, with `--outside` those; "
        "`policy.about` has all arguments.",
        "",
        "| policy | environment | learner, hidden units | learned from | return | success | "
        "final error | outside: return, success |",
        "|---|---|---|---|---:|---:|---:|---:|",
    ]
    for path in sorted(folder.glob("*.pt")):
        policy = load(path)
        about, scores = policy.about, policy.about["scores"]
        hidden = " x ".join(map(str, policy.shape["sizes"][1:-1]))
        hidden += f" and a GRU of {policy.memory}" if policy.memory else ""
        algorithm = path.stem.removeprefix(f"{about['task']}-")
        arguments = ", ".join(
            "uncertain plants" if name == "randomize" else f"{name}={value}"
            for name, value in about["arguments"].items()
        )
        outside = scores.get("outside")
        beyond = f"{outside['return']:.3g}, {100 * outside['success']:.0f} %" if outside else ""
        lines.append(
            f"| `{path.name}` | `{about['env']}`{': ' if arguments else ''}{arguments} | "
            f"{label(algorithm, about['task'])}, {hidden} | {scores['chosen_steps']:,} of "
            f"{scores['steps']:,} steps in {scores['seconds']:.0f} CPU s | "
            f"{scores['return']:.3g} ± {scores['return_deviation']:.2g} | "
            f"{100 * scores['success']:.0f} % | {1e3 * scores['final_error']:.1f} mm | {beyond} |"
        )
    lines += [
        "",
        "Scores are means over the held-out episodes, returns with the standard deviation over "
        "them; what is a success, `training/tuned.py` says. *Outside*: plants from ranges half as "
        "wide again, each beyond the training range in at least one number.",
    ]
    return "\n".join(lines) + "\n"


def keep(study: Path, algorithms: Sequence[str], folder: Path = KEPT) -> list[str]:
    """Put the policies of these algorithms, of a study's policies/, beside those that are there, in
    place of any of the same name; returns their names.
    """
    source = study / "policies"
    made = json.loads((source / "scores.json").read_text())
    names = [name for name, run in made.items() if run["algorithm"] in algorithms]
    for name in names:
        shutil.copyfile(source / name, folder / name)
    scores = json.loads((folder / "scores.json").read_text())
    scores = dict(sorted((scores | {name: made[name] for name in names}).items()))
    (folder / "scores.json").write_text(json.dumps(scores, indent=2) + "\n")
    (folder / "README.md").write_text(cards(folder))
    return names


def main(argv: Sequence[str] | None = None) -> int:
    """Keep policies of a study in training/policies."""
    parser = argparse.ArgumentParser(prog="python -m training.cards", description=main.__doc__)
    parser.add_argument("study", type=Path, help="folder that training.results has written")
    parser.add_argument("--algorithms", nargs="+", default=["shac"], help="default: %(default)s")
    options = parser.parse_args(argv)
    if not (options.study / "policies/scores.json").exists():
        parser.error(f"{str(options.study)!r} was given, which holds no policies of a study")
    print(", ".join(keep(options.study, options.algorithms)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
