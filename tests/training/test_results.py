"""training/results.py, table.py and report.py: a run has its own file, what is there is kept, the
table says what the files say.
"""

import csv
import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch
from torchbeam_envs.baselines import JointLQG, JointLQR

from tests.cases.tiny_task import SHORT as TINY
from training import baselines, cards, common, curves, evaluate, report, results, table, tuned
from training.policies import load
from training.tuned import TASKS, Task

torch.set_num_threads(1)
SMALL = dict(num_envs=4, horizon=4, hidden=(8,))


def test_one_command(tmp_path, monkeypatch, capsys):
    """Two learners and two baselines; called again, nothing is made again; a run that fails is
    named and the others go on.
    """
    monkeypatch.setitem(TASKS, "tiny", TINY)
    for name in ("ppo", "shac"):
        learner, arguments, _ = results.LEARNERS[name]
        monkeypatch.setitem(results.LEARNERS, name, (learner, arguments, {"tiny": SMALL}))
    monkeypatch.setitem(results.BASELINES, "pd", lambda task: 1 / 0)
    options = [
        "--tasks",
        "tiny",
        "--seeds",
        "2",
        "--budget",
        "32",
        "--episodes",
        "4",
        "--jobs",
        "1",
        "--out",
        str(tmp_path),
        "--algorithms",
        "zero",
        "static",
        "pd",
        "ppo",
        "shac",
    ]
    assert results.main(options) == 1
    said = capsys.readouterr().out
    assert (
        "7 runs, 0 of them done" in said
        and "tiny-pd failed: ZeroDivisionError" in said
        and "| tiny | SHAC |" in said
    )
    runs = {path.stem: json.loads(path.read_text()) for path in (tmp_path / "runs").glob("*.json")}
    learned = [f"tiny-{name}-{k}" for name in ("ppo", "shac") for k in (0, 1)]
    assert sorted(runs) == sorted(["tiny-zero", "tiny-static", *learned])
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "runs").glob("*.json")}
    monkeypatch.setitem(results.BASELINES, "pd", results.BASELINES["zero"])
    assert results.main(options) == 0
    assert "7 runs, 6 of them done" in capsys.readouterr().out
    # a line across the curves, which are of these episodes
    still = results.scores(TINY, results.BASELINES["zero"](TINY), 4)
    line = common.validation(TINY, results.BASELINES["zero"](TINY), evaluate.make(TINY, 64))
    assert runs["tiny-zero"]["validation_return"] == line["validation_return"] != still["return"]
    assert before == {path: path.stat().st_mtime_ns for path in before} and not list(
        (tmp_path / "runs").glob("*.failed")
    )
    monkeypatch.setitem(results.LEARNERS["shac"][2], "tiny", {**SMALL, "rate": 1e-3})
    assert results.main(options) == 0  # other settings: made again
    assert "7 runs, 5 of them done" in capsys.readouterr().out
    runs |= {path.stem: json.loads(path.read_text()) for path in before if "shac" in path.stem}
    assert runs["tiny-shac-0"]["settings"]["rate"] == 1e-3
    said = (tmp_path / "summary.md").read_text()
    assert "| plants | task | the best linear controller | PPO | SHAC |" in said
    assert "% (PD) |" in said
    assert said.count("(2)") == 2  # seeds of each learner
    assert "| nominal | SHAC | PPO | 1 |" in (tmp_path / "ahead.md").read_text()
    rows = list(csv.DictReader(open(tmp_path / "results.csv")))
    assert [row["algorithm"] for row in rows] == ["zero", "static", "pd", "ppo", "shac"]
    mean = np.mean([runs[f"tiny-shac-{k}"]["return"] for k in (0, 1)])
    assert (
        float(rows[-1]["return"]) == pytest.approx(mean) and float(rows[-1]["common_steps"]) == 32
    )
    policy = load(tmp_path / "policies/tiny-shac.pt")
    assert (
        policy.about["scores"]["return"]
        == json.loads((tmp_path / "policies/scores.json").read_text())["tiny-shac.pt"]["return"]
    )
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "scores.json").write_text("{}")
    assert cards.keep(tmp_path, ["shac"], kept) == ["tiny-shac.pt"]
    assert "`tiny-shac.pt`" in (kept / "README.md").read_text()
    assert list(json.loads((kept / "scores.json").read_text())) == ["tiny-shac.pt"]
    assert (tmp_path / "policies/tiny-shac.pt").stat().st_size < 200_000 and (
        tmp_path / "curves.png"
    ).exists()


def test_table_compares_at_what_all_have_had():
    """Five seeds of one learner with 100 steps in 10 s, one of another with 50 in 20 s; returns
    grow by one a step.
    """

    def run(algorithm, seed, steps, seconds):
        return {
            "task": "t",
            "algorithm": algorithm,
            "seed": seed,
            "return": float(steps),
            "success": 1.0,
            "final_error": 0.0,
            "within": 1.0,
            "within_half": 1.0,
            "steps": steps,
            "seconds": seconds,
            "ended": 0,
            "solver_failures": 0,
            "outside": None,
            "episodes": 4,
        }

    def curve(run):
        share = np.linspace(0, 1, 11)
        return {
            "steps": share * run["steps"],
            "seconds": share * run["seconds"],
            "validation_return": share * run["steps"],
        }

    rows = table.rows(
        [*(run("ppo", k, 100, 10.0) for k in range(5)), run("shac", 0, 50, 20.0)], curve
    )
    by = {row["algorithm"]: row for row in rows}
    assert by["ppo"]["return_at_steps"] == pytest.approx(50) and by["shac"][
        "return_at_steps"
    ] == pytest.approx(50)
    assert by["ppo"]["return_at_seconds"] == pytest.approx(100) and by["shac"][
        "return_at_seconds"
    ] == pytest.approx(25)
    assert by["ppo"]["return_low"] == by["ppo"]["return"] == by["ppo"]["return_high"] == 100
    assert all(row["better"] is None for row in rows)  # there is no linear controller


def test_no_return_is_told_before_the_first_validation():
    """One learner ends at 30 steps and 20 s; another is first validated at 20 steps and 5 s, a
    third at 40 and 30: a line from the policy that has learned nothing tells of none there was.
    """
    ends = {"sac": ([0, 15, 30], [0, 10, 20]), "ppo": ([0, 20, 40], [0, 5, 10])}
    ends["shac"] = ([0, 40, 80], [0, 30, 60])

    def curve(run):
        steps, seconds = (np.array(at, dtype=float) for at in ends[run["algorithm"]])
        return {"steps": steps, "seconds": seconds, "validation_return": -100 + steps}

    runs = [
        {"task": "track", "algorithm": name, "seed": 0, "return": 0.0, "success": 1.0}
        | {"final_error": 0.0, "within": 1.0, "within_half": 1.0, "steps": 1, "seconds": 1.0}
        | {"ended": 0, "solver_failures": 0, "outside": None, "episodes": 4}
        for name in ends
    ]
    by = {row["algorithm"]: row for row in table.rows(runs, curve)}
    told = [by[name]["return_at_steps"] for name in ("sac", "ppo", "shac")]
    assert told == [pytest.approx(-70), pytest.approx(-70), None]
    told = [by[name]["return_at_seconds"] for name in ("sac", "ppo", "shac")]
    assert told == [pytest.approx(-85), pytest.approx(-60), None]
    pairs = {(row["algorithm"], row["over"]): row for row in table.comparisons(runs, curve)}
    assert pairs["sac", "ppo"]["at_steps"] == 0.5 and pairs["sac", "ppo"]["at_seconds"] == 0
    for other, at_steps in (("sac", None), ("ppo", 0.5)):
        row = pairs["shac", other]
        assert row["at_steps"] == at_steps and row["at_seconds"] is None
        assert row["probability"] == 0.5


def test_a_run_says_of_which_commit_it_is():
    tree = Path(results.__file__).parents[1]
    if not (tree / ".git").exists():
        assert results.commit() is None
        return
    head = ["git", "-C", str(tree), "rev-parse", "HEAD"]
    told = subprocess.run(head, capture_output=True, text=True, check=True).stdout.strip()
    assert results.commit().removesuffix("+") == told


def test_code_is_told_by_what_is_in_its_files(tmp_path, monkeypatch):
    """Another byte of the environments is other code; another place is not."""
    digests = []
    for place, text in (("a", "x = 1"), ("b", "x = 1"), ("c", "x = 2")):
        folder = tmp_path / place / "torchbeam_envs"
        folder.mkdir(parents=True)
        (folder / "__init__.py").write_text(text)
        monkeypatch.setattr(results.torchbeam_envs, "__file__", str(folder / "__init__.py"))
        results.code.cache_clear()
        digests.append(results.code())
    results.code.cache_clear()
    assert digests[0] == digests[1] != digests[2]


def test_runs_that_are_not_alike_are_told_of():
    """But for their seeds."""
    one = {"task": "track", "algorithm": "ppo", "budget": {"steps": 8}, "episodes": 4, "seed": 0}
    one |= {"environment": {"arguments": {"frames": 4}}, "settings": {"rate": 1e-3, "seed": 0}}
    same = {**one, "seed": 1, "settings": {"rate": 1e-3, "seed": 1}}
    assert report.mixed([one, same]) == []
    for other in (
        {"budget": {"steps": 9}},
        {"episodes": 5},
        {"environment": {"arguments": {"frames": 12}}},
        {"settings": {"rate": 1e-2, "seed": 1}},
    ):
        (said,) = report.mixed([one, {**same, **other}])
        assert "are runs of track PPO: " in said


def test_learners_are_compared_task_by_task():
    """Two tasks: of four pairs of seeds three are ahead in one, none in the other, which the third
    learner has not played; one at another level. Curves rise by one a step and two a second, those
    of SHAC by three times as much in time.
    """
    returns = {
        "a": {"lqr": [2.5], "lqg": [-1.0], "ppo": [1.0, 3.0], "shac": [2.0, 4.0]},
        "b": {"ppo": [5.0, 6.0], "shac": [0.0]},
        "b-uncertain": {"ppo": [5.0, 6.0], "shac": [7.0]},
    }
    returns["a"]["sb3-ppo"] = [0.0]
    runs = [
        {"task": task, "algorithm": name, "return": value, "seed": seed}
        for task, of in returns.items()
        for name, values in of.items()
        for seed, value in enumerate(values)
    ]

    def curve(run):
        steps = np.linspace(0.0, 10.0, 11)
        pace = 3.0 if run["algorithm"] == "shac" else 1.0
        return {"steps": steps, "seconds": steps / 2 / pace, "validation_return": steps}

    rows = table.comparisons(runs, curve)
    compared = {(row["level"], row["algorithm"], row["over"]): row for row in rows}
    both = compared["nominal", "shac", "ppo"]
    assert both["probability"] == pytest.approx((0.75 + 0.0) / 2)
    assert both["tasks"] == ["a", "b"]
    assert (both["at_steps"], both["at_seconds"]) == (0.5, 1.0)
    assert compared["nominal", "sb3-ppo", "shac"]["probability"] == 0.0
    assert compared["nominal", "sb3-ppo", "shac"]["tasks"] == ["a"]
    assert compared["uncertain", "shac", "ppo"]["probability"] == 1.0
    assert compared["nominal", "shac", "linear"]["probability"] == 0.5  # one of 2, 4 over 2.5
    assert compared["nominal", "shac", "linear"]["at_steps"] is None
    assert ("uncertain", "shac", "linear") not in compared
    assert "| nominal | SHAC | the best linear controller | 1 | 50 % |" in report.ahead(rows)


def test_what_seeds_tell_of_a_linear_controller():
    runs = [
        {
            "task": "t",
            "algorithm": name,
            "seed": k,
            "return": value,
            "success": 1.0,
            "outside": None,
        }
        | {"final_error": 0.0, "steps": 1, "seconds": s, "ended": 0, "solver_failures": 0}
        | {"within": 1.0, "within_half": 1.0}
        | {"episodes": 4}
        for name, s, values in (
            ("pd", None, [-9.0]),
            ("lqr", None, [-5.0]),
            ("ppo", 1.0, [-6.0, -4.0, -6.0, -4.0, -6.0]),
        )
        for k, value in enumerate(values)
    ]
    log = {"steps": np.array([0.0, 1.0]), "seconds": np.array([0.0, 1.0])}
    log["validation_return"] = np.array([-10.0, -5.0])
    rows = table.rows(runs, lambda run: log if run["algorithm"] == "ppo" else None)
    last = rows[-1]
    assert (last["algorithm"], last["better"]) == ("ppo", 0.4)
    assert (last["better_low"], last["better_high"]) == (0.0, 0.8)
    assert "| t | LQR + static | -5.00 |" in report.markdown(rows)


def test_scores_lie_between_no_action_and_the_best_baseline():
    """Two tasks of an uncertain level; by hand: of (0.25, 0.75) and (0.5, 0.5) the middle half is
    0.5. A learner that misses one of the tasks has no score; outside it is the other returns' turn.
    """
    given = {
        "a-uncertain": {"zero": [-8.0], "lqg": [-5.0], "mpc": [-4.0], "ppo": [-7.0, -5.0]},
        "b-uncertain": {"zero": [-2.0], "mpc-informed": [0.0], "ppo": [-1.0] * 2, "sac": [0.0]},
    }
    runs = [
        {"task": task, "algorithm": name, "return": value, "outside": {"return": 10 * value}}
        for task, of in given.items()
        for name, values in of.items()
        for value in values
    ]
    rows = table.aggregates(runs)
    score = {(row["measure"], row["algorithm"]): row for row in rows}
    assert set(score) == {(m, name) for m in ("score", "outside") for name in ("zero", "ppo")}
    assert score["score", "ppo"]["score"] == score["outside", "ppo"]["score"] == 0.5
    low, high = (score["score", "ppo"][f"score_{end}"] for end in ("low", "high"))
    assert np.isnan([low, high]).all()  # of two seeds a task
    assert {row["level"] for row in rows} == {"uncertain"}
    assert "| PPO | 50.0 % (50.0) | 50.0" in report.aggregate(rows)


def test_the_study_is_fair_wherever_it_is_cut_off(tmp_path):
    """Every task and level, ten seeds of each learner of ours; no algorithm is ever two seeds ahead
    of itself on another task in the plane, and named tasks or algorithms are each with each.
    """
    runs = results.plan(results.parse(["--out", str(tmp_path)]))
    assert len(runs) == len(set(runs))
    count = {}
    for run in runs:
        count[run.algorithm, run.task] = count.get((run.algorithm, run.task), 0) + 1
        plane = {pair: n for pair, n in count.items() if pair[1] not in results.SPACE}
        own = [n for (algorithm, _), n in plane.items() if algorithm == run.algorithm]
        assert not own or max(own) - min(own) <= 1
    for task in tuned.DEFAULT:
        assert all(count[name, task] == 10 for name in ("ppo", "sac", "shac"))
        assert all(count[name, task] == 1 for name in ("zero", "lqr", "lqg", "mpc"))
    assert not {task for _, task in count} & {*tuned.PUBLISHED}
    for given, expected in (
        (["--seeds", "2", "--tasks", "follow"], 1 + 1 + 3 * 2),  # baselines that are for it
        (["--seeds", "2", "--tasks", "follow", "--algorithms", "lqr"], 1),
        (["--seeds", "1", "--tasks", "reach"], 8 + 3),
        (["--seeds", "2", "--algorithms", "sb3-ppo"], 2 * len(tuned.DEFAULT)),
        (["--seeds", "12", "--tasks", "grip", "--algorithms", "zero", "shac"], 1 + 12),
        (["--seeds", "1"], len({(run.task, run.algorithm) for run in runs})),
    ):
        assert len(results.plan(results.parse([*given, "--out", str(tmp_path)]))) == expected


def test_all_controllers_are_in_one_table(tmp_path):
    """Of both levels and plants outside, those that estimate from files beside the study: the best
    of two linear controllers, which is another outside, and in bold the largest return of those
    that do not know the plant.
    """
    entries = ("return", "return_low", "return_high", "success")

    def row(name, value, outside, runs=1):
        own = dict(zip(entries, (value, value - (runs > 1), value + (runs > 1), 0.5), strict=True))
        beyond = dict(zip(entries, (outside, outside, outside, 0.25), strict=True))
        own |= {f"outside_{key}": one for key, one in beyond.items()}
        return {"task": "track-uncertain", "algorithm": name, "runs": runs, **own}

    lines = [row("lqr", -8, -40), row("lqg", -9, -30), row("shac", -6, -20, 5)]
    lines += [row("mpc-informed", -0.125, -0.5), row("zero", -90, -90)]
    lines += [{**row("mpc", -2, 0), "task": "track", "outside_return": None}]
    for folder, controllers in (
        ("adaptive", (("AdaptiveMPC", -1.5), ("bound", -0.25), ("Estimated(LQR)", -7.0))),
        ("adaptive_outside", (("AdaptiveMPC", -25.0),)),
    ):
        (tmp_path / folder).mkdir()
        made = [
            {"task": "track", "controller": name, "total": value, "success": 0.75}
            for name, value in controllers
        ]
        (tmp_path / folder / "adaptive.json").write_text(json.dumps({"rows": made}))
    lines += report.estimating(tmp_path / "study")
    assert report.summary(lines).splitlines()[2:] == [
        "| nominal | track |  | **-2.00**, 50 % |  |  |  |  |",
        "| uncertain | track | -8.00, 50 % (LQR) |  | **-1.50**, 75 % | "
        "-6.00 [-7.00, -5.00], 50 % (5) | -0.125, 50 % | -0.250, 75 % |",
        "| outside | track | -30.0, 25 % (LQG) |  | -25.0, 75 % | **-20.0**, 25 % (5) | "
        "-0.500, 25 % |  |",
    ]
    shown = {name: report._plants(lines, name) for name in report.PLANTS}
    entries = {name: entry for name, (_, entry) in report.PLANTS.items()}
    curves.costs(tmp_path, shown, entries, report.NAMES, report.CONTROLLERS)
    assert (tmp_path / "costs.png").stat().st_size > 10_000
    assert not report.estimating(tmp_path / "elsewhere" / "study")


def test_published_tasks_are_in_no_mean(tmp_path):
    """They have numbers of their own: they are in no grid, in no mean over the tasks of a level, in
    no picture of costs and in no comparison.
    """
    (tmp_path / "runs").mkdir()
    for task, algorithm, seed, value in (
        ("follow", "zero", None, -150.0),
        ("follow", "shac", 0, 400.0),
        ("follow", "shac", 1, 500.0),
        ("follow", "ppo", 0, 100.0),
        ("track", "zero", None, -90.0),
        ("track", "lqr", None, -1.0),
    ):
        run = dict(task=task, algorithm=algorithm, seed=seed, outside=None, episodes=4, ended=0)
        run |= {"return": value, "success": 0.5, "final_error": 0.08, "solver_failures": 0}
        run |= dict(steps=0 if seed is None else 1000, seconds=None if seed is None else 9.0)
        run |= {"validation_return": value} if seed is None else {}
        run |= dict(within=0.75, within_half=0.25)
        name = results.Run(task, algorithm, seed).name
        (tmp_path / "runs" / f"{name}.json").write_text(json.dumps(run))
        if seed is not None:
            log = f"steps,seconds,validation_return\n0,0,-150\n500,4,0\n1000,9,{value}\n"
            (tmp_path / "runs" / f"{name}.csv").write_text(log)
    report.report(tmp_path)
    assert "published" not in (tmp_path / "ahead.md").read_text()
    assert "| follow | 1,000, 9 s | 1,000, 9 s |" in (tmp_path / "budgets.md").read_text()
    assert "follow" not in (tmp_path / "summary.md").read_text()
    made = json.loads((tmp_path / "results.json").read_text())
    assert {(row["level"], row["algorithm"], row["tasks"]) for row in made["aggregates"]} == {
        ("nominal", "zero", 1),
        ("nominal", "lqr", 1),
    }
    assert not made["comparisons"]
    assert not (tmp_path / "published.md").exists() and not (tmp_path / "curves.png").exists()


def test_budgets_are_steps(tmp_path):
    """Of each learner by itself, unless steps or CPU time are asked for."""
    run = results.Run("reach", "shac", 0)

    def budget(*given):
        return vars(results.budget(results.parse([*given, "--out", str(tmp_path)]), run))

    whole = tuned.budget("shac", "reach")
    assert budget() == {"steps": whole, "minutes": None}
    assert budget("--share", "0.25") == {"steps": whole // 4, "minutes": None}
    assert budget("--budget", "9") == {"steps": 9, "minutes": None}
    assert budget("--minutes", "2") == {"steps": None, "minutes": 2.0}
    assert set(tuned.BUDGETS) == {*results.LEARNERS, *results.LIBRARIES}


def test_runs_of_other_episodes_are_made_again(tmp_path):
    """Scores of a quick study are no scores of a whole one: those of baselines, learners and
    libraries alike. One baseline alone plays fewer than the others.
    """
    few, all_of_them = (
        results.parse(["--episodes", episodes, "--out", str(tmp_path)])
        for episodes in ("32", "256")
    )
    for run in (results.Run("reach", name, None) for name in results.BASELINES):
        assert results.held_out(run, few) == 32
        assert results.held_out(run, all_of_them) == (64 if run.algorithm == "optimum" else 256)
    for task, most in (("reach-behind", 1), ("track-target", 16)):  # the others would be the same
        assert results.held_out(results.Run(task, "student", 0), few) == most
    for name in ("mpc", "shac", "sb3-ppo", "skrl-ppo"):
        run, _ = made("reach", name, few, tmp_path)
        budget = results.budget(few, run)
        assert results.is_made(run, tmp_path, budget, results.held_out(run, few))
        assert not results.is_made(run, tmp_path, budget, results.held_out(run, all_of_them))


def made(task, name, options, folder):
    """A run as if it were made, and what is in its file."""
    run = results.Run(task, name, None if name in results.BASELINES else 0)
    there = {"budget": vars(results.budget(options, run)), "environment": run.environment}
    there |= {"algorithm": name}
    there |= {"episodes": options.episodes, "validation_return": -1.0}
    there |= {"settings": {} if name in results.BASELINES else run.settings}
    (folder / f"{run.name}.json").write_text(json.dumps(there))
    return run, there


@pytest.mark.parametrize("name", ["lqg", "ppo", "sac", "shac", "sb3-sac", "skrl-ppo"])
def test_runs_of_other_settings_are_made_again(name, tmp_path, monkeypatch):
    """Whichever of them changed, also what no task names, or the task itself."""
    options = results.parse(["--out", str(tmp_path)])
    run, there = made("track", name, options, tmp_path)
    budget = results.budget(options, run)
    assert results.is_made(run, tmp_path, budget, options.episodes)
    for key in there["settings"]:
        other = {**there, "settings": {**there["settings"], key: "another"}}
        (tmp_path / f"{run.name}.json").write_text(json.dumps(other))
        assert not results.is_made(run, tmp_path, budget, options.episodes), key
    (tmp_path / f"{run.name}.json").write_text(json.dumps(there))
    other = tuned.TASKS["track"].varied(elements=6)
    monkeypatch.setitem(tuned.TASKS, "track", other)
    assert not results.is_made(run, tmp_path, budget, options.episodes)


def test_baselines_are_tuned_on_training_episodes(monkeypatch):
    """No seed of a held-out episode is used, and the LQR that is picked is the best there."""
    seen = []
    monkeypatch.setattr(baselines, "EFFORTS", (0.1, 100.0))
    monkeypatch.setattr(baselines, "SPEEDS", (0.1, 1e3))
    monkeypatch.setattr(baselines, "SCHEDULES", (1,))
    monkeypatch.setattr(baselines, "DISTURBANCES", (0.0, 0.1))
    monkeypatch.setattr(baselines, "ACTIONS", (0.1,))
    monkeypatch.setattr(baselines, "EPISODES", 4)
    scored = baselines.evaluate
    monkeypatch.setattr(
        baselines, "evaluate", lambda *given: seen.append(given[3]) or scored(*given)
    )
    controller = baselines.BASELINES["lqr"](
        Task("tiny", "torchbeam/TipReachPlanar-v1", dict(elements=2, substeps=1))
    )
    best = {"effort": 0.1, "speed_weight": 0.1, "schedule": 1}
    assert controller.settings == best and set(seen) == {baselines.TRAINING}
    values = (0.01, 0.1, 1.0, 10.0)
    for best in values:  # of a score that rises to one and falls
        scores = {value: -abs(value - best) for value in values}
        tops = baselines.climbed({"a": 1.0}, "effort", values, lambda c, s=scores: s[c["effort"]])
        assert tops == {"a": 1.0, "effort": best}
    turn = Task(
        "turn", "torchbeam/SlewPlanar-v1", dict(elements=2, substeps=1, max_episode_steps=5)
    )
    assert isinstance(baselines.BASELINES["lqr"](turn), JointLQR)
    late = baselines.BASELINES["lqg"](turn.varied(randomize={"latency": (0.0, 1.0)}))
    assert isinstance(late, JointLQG)
    assert set(late.settings) == {"effort", "speed_weight", "latency", "disturbance", "action"}


def test_refusals(tmp_path):
    for given in (["--seeds", "0"], ["--minutes", "0"], ["--jobs", "-1"], ["--share", "0"]):
        with pytest.raises(SystemExit):
            results.main([*given, "--out", str(tmp_path)])


def test_who_knows_the_plant_is_never_the_best():
    """Though it returns as much, as it does where every plant is the model's."""
    rows = [
        {"task": "track", "algorithm": name, "runs": 1, "success": 1.0, "outside_return": None}
        | {f"return{end}": value for end in ("", "_low", "_high")}
        for name, value in (("lqr", -2.0), ("mpc", -0.014), ("mpc-informed", -0.014))
    ]
    cells = "-2.00, 100 % (LQR) | **-0.014**, 100 % | -0.014, 100 % |"
    assert report.summary(rows).endswith(f"| nominal | track | {cells}")
