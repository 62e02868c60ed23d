"""The policies of a study that are kept, and what is to be known of them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from .policies import load


def policies(out: Path, runs: list[dict[str, Any]]) -> None:
    """Copy the policies of seed 0 (not of the best seed) with their scores, and their cards."""
    folder, scores = out / "policies", {}
    for run in runs:
        source = out / "runs" / f"{run['task']}-{run['algorithm']}-{run['seed']}.pt"
        if run["seed"] == 0 and source.exists():
            folder.mkdir(exist_ok=True)
            name = f"{run['task']}-{run['algorithm']}.pt"
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
        "Networks of the first seed of each study, for the plants that they were trained on and the "
        "observation of their task: elsewhere nothing is known of them but what stands under "
        "*outside*. `training.policies.load` reads them, `python -m training.evaluate FILE` makes "
        "the scores again, with `--outside` those; `policy.about` has all arguments.",
        "",
        "| policy | environment | learner, hidden units | learned from | return | success | "
        "final error | outside: return, success |",
        "|---|---|---|---|---:|---:|---:|---:|",
    ]
    for path in sorted(folder.glob("*.pt")):
        policy = load(path)
        about, scores = policy.about, policy.about["scores"]
        hidden = " x ".join(map(str, policy.shape["sizes"][1:-1]))
        arguments = ", ".join(
            "uncertain plants" if name == "randomize" else f"{name}={value}"
            for name, value in about["arguments"].items()
        )
        outside = scores.get("outside")
        beyond = f"{outside['return']:.3g}, {100 * outside['success']:.0f} %" if outside else ""
        lines.append(
            f"| `{path.name}` | `{about['env']}`: {arguments} | "
            f"{path.stem.rpartition('-')[2].upper()}, {hidden} | {scores['chosen_steps']:,} of "
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
