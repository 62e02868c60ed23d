"""How surely a trained controller brings the tip of a strip to its target, when stiffness and mass
are not what they should be.

The policy that `python -m torchbeam demo` learned on strips whose stiffness varies by 15 %, all
equally likely; here stiffness and mass are lognormal with 15 % each, targets random, none of them
seen before. As in the demo, the controller is given the action that holds the target. Success:
within 2 % of the length over the last 0.2 s of an episode of 1 s.

python examples/uncertainty_controller.py docs/results/uncertainty    # writes controller.md, .csv
and .json there
"""

import sys
from pathlib import Path

import torch
from torchbeam_envs import aluminium_strip, holding_action
from torchbeam_envs.demo import TASK
from torchbeam_envs.demo.controllers import Policy
from torchbeam_envs.demo.episodes import CLOSE, WINDOW, Targets, evaluate, make

import torchbeam as tb
from torchbeam.extend.commands import measured_on, sentence, table, write_results

SAMPLES, SEED = 256, 3_000_000
LAWS = {
    "stiffness": tb.laws.LogNormal(1.0, 0.15),
    "mass": tb.laws.LogNormal(1.0, 0.15),
    "target": (0.0, 1.0),
}
POLICY = Policy()
POLICY.load_state_dict(
    torch.load(Path(__file__).parents[1] / "docs/results/demo/policy.pt", weights_only=True)
)


def episode(
    stiffness: torch.Tensor, mass: torch.Tensor, target: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Largest distance (samples,) of the tip from its target over the last 0.2 s, over the length;
    status 7 where the solver failed.
    """
    strip = aluminium_strip()
    section = strip.like(
        strip.compliance / stiffness[:, None, None], strip.mass * mass[:, None, None]
    )
    settings = {**TASK, "section": section}
    seeds = (SEED + 1e6 * target).long().tolist()
    env = make(settings, len(seeds))
    env.reset(seed=seeds)
    hold = holding_action(env.scene, env.state.goal, env.task.actions, env.task.inputs)
    record = evaluate(env, POLICY, Targets(seeds, hold))
    last = record.distance[-round(WINDOW / record.interval) :]
    return last.amax(0) / record.length, torch.where(record.failed, 7, 0)


samples = tb.monte_carlo(
    episode,
    LAWS,
    SAMPLES,
    design="plain",
    chunk=128,
    by_name=True,
    sentences={7: "the solver failed"},
)
missed = samples.exceedance(CLOSE, failed_exceed=True)
distance = samples.quantile((0.5, 0.95), interval=0.95)
ANSWERS = {  # estimate, low, high
    "success, %": tuple(100 * (1 - x.item()) for x in (missed.estimate, missed.high, missed.low)),
    "median distance, % of the length": tuple(100 * x[0].item() for x in distance),
    "distance in 95 % of the episodes, % of the length": tuple(100 * x[1].item() for x in distance),
}
print(samples)
for answer, (estimate, low, high) in ANSWERS.items():
    print(f"{answer}: {estimate:.3g}, {low:.3g} to {high:.3g} at 95 %")

CHECK = ANSWERS["success, %"][0] / 100
EXPECTED, TOLERANCE = 0.984, 0.012  # three episodes, which may lie close to the limit


def store(folder: Path = Path("out")) -> None:
    heading = measured_on()
    columns = ("answer", "estimate", "low", "high")
    about = (
        f"The demo's policy over {SAMPLES} episodes, stiffness and mass lognormal with 15 % each, "
        f"targets random. Success: within {100 * CLOSE:g} % of the length over the last {WINDOW:g} "
        f"s; {samples.failed} episodes failed, which count as no success. Intervals at 95 %: "
        "Clopper and Pearson's of the success, order statistics of the distance."
    )
    rows = [(answer, *numbers) for answer, numbers in ANSWERS.items()]
    text = table(
        columns, [[name, *(f"{x:.3g}" for x in numbers)] for name, numbers in ANSWERS.items()], 1
    )
    write_results(
        folder,
        "controller",
        "\n\n".join((about, text, sentence(heading))),
        {
            **heading,
            "samples": SAMPLES,
            "seed": SEED,
            "failed": samples.failed,
            "reasons": samples.reasons,
            "rows": [dict(zip(columns, row, strict=True)) for row in rows],
        },
        columns,
        rows,
    )
    print(f"wrote {folder}")


if __name__ == "__main__":
    store(*map(Path, sys.argv[1:2]))
