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
        "Networks of the first seed of each study, for the plant that they were trained on and the "
        "observation of their task: elsewhere nothing is known of them. `training.policies.load` "
        "reads them, `python -m training.evaluate FILE` makes the scores again.",
        "",
        "| policy | environment | learner, hidden units | learned from | return | success | "
        "final error |",
        "|---|---|---|---|---:|---:|---:|",
    ]
    for path in sorted(folder.glob("*.pt")):
        policy = load(path)
        about, scores = policy.about, policy.about["scores"]
        hidden = " x ".join(map(str, policy.shape["sizes"][1:-1]))
        arguments = ", ".join(f"{k}={v}" for k, v in about["arguments"].items())
        lines.append(
            f"| `{path.name}` | `{about['env']}`: {arguments} | "
            f"{path.stem.rpartition('-')[2].upper()}, {hidden} | {scores['chosen_steps']:,} of "
            f"{scores['steps']:,} steps in {scores['seconds']:.0f} CPU s | "
            f"{scores['return']:.3g} ± {scores['return_deviation']:.2g} | "
            f"{100 * scores['success']:.0f} % | {1e3 * scores['final_error']:.1f} mm |"
        )
    lines += [
        "",
        "Scores are means over the held-out episodes, returns with the standard deviation over "
        "them; what is a success, `training/tuned.py` says.",
    ]
    return "\n".join(lines) + "\n"
