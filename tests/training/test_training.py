"""training/: gradients of a window, runs that resume in the same bits, learners that learn, files
that load.
"""

import csv
import importlib
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torchbeam_envs.baselines import LQR, Zero

from tests.cases.tiny_task import TINY
from tests.cases.training_checks import check_gradient, check_lessons
from torchbeam.solvers import newton
from training import common, ppo, results, sac, shac, student
from training.evaluate import evaluate, make
from training.evaluate import main as evaluation
from training.policies import Policy, Statistics, load, save, squashed
from training.tuned import HELD_OUT, TASKS, Task

torch.set_num_threads(1)
LEARNERS = {
    "ppo": (ppo.PPO, ppo.Arguments),
    "sac": (sac.SAC, sac.Arguments),
    "shac": (shac.SHAC, shac.Arguments),
}
SOFT = {"entropy": 0.1, "critics": 2}
TAUGHT = {"teacher": "LQR", "lessons": 3}
SMALL_SAC = {"warmup": 32, "updates": 4, "minibatch": 16, "replay": 80}


def learner(name, task=TINY, **settings):
    made, arguments = LEARNERS[name]
    small = {"num_envs": 4, "horizon": 8, "hidden": (16,), **(SMALL_SAC if name == "sac" else {})}
    return made(task, arguments(**{**small, **settings}))


def trained(folder, steps):
    options = dict(episodes=2, final=2, progress=False)
    return common.train(learner("shac"), TINY, folder, common.Budget(steps=steps), **options)


@pytest.mark.parametrize("settings", [{}, SOFT])
def test_gradient_of_a_window_is_that_of_differences(settings, monkeypatch):
    """32 steps, episode ends within them, critic's values and the entropy in the objective: central
    differences in two directions of the policy's weights, in float64. 1e-6 is what differences of
    step 1e-5 are worth where Newton's method goes as far as it can: the gradient is that of an
    exact solution.
    """
    monkeypatch.setitem(newton.TOLERANCE, torch.float64, 1e-12)
    one = learner("shac", horizon=32, num_envs=3, **settings)
    for part in (one.policy, one.spread, one.target):
        part.double()
    start, noise = common.environment_state(one.env), one.generator.get_state()

    def objective():
        common.restore_environment(one.env, start)
        one.generator.set_state(noise)
        return one.window()[0].mean()

    unused = one.policy.log_deviation if settings else None  # what is seen gives it then
    check_gradient(objective, [weights for weights in one.parts if weights is not unused])


def test_a_soft_shac_ascends_the_mean_of_critics_and_trusts_the_least():
    """Of two that say 1 and 3 everywhere: as one that says 2 for the policy, as one that says 1 for
    the targets.
    """
    start, says = learner("shac", **SOFT), {}
    state, noise = common.environment_state(start.env), start.generator.get_state()
    for values in ((1.0, 3.0), (2.0, 2.0), (1.0, 1.0)):
        for critic, value in zip(start.target, values, strict=True):
            critic.network[-1].weight.data.zero_()
            critic.network[-1].bias.data.fill_(value)
        common.restore_environment(start.env, state)
        start.generator.set_state(noise)
        objective, data = start.window()
        says[values] = objective.detach(), start.targets(data)[1]
    torch.testing.assert_close(says[1.0, 3.0][0], says[2.0, 2.0][0], rtol=1e-6, atol=0)
    torch.testing.assert_close(says[1.0, 3.0][1], says[1.0, 1.0][1], rtol=1e-6, atol=0)
    assert (says[1.0, 3.0][0] > says[1.0, 1.0][0] + 0.01).all()
    assert (data["entropy"] != 0).all()


def test_the_density_of_squashed_actions():
    """That of torch's transformed normal distribution, to 1e-10 where tanh is below 0.99."""
    generator = torch.Generator().manual_seed(0)
    mean, deviation, noise = torch.rand(3, 50, 2, generator=generator, dtype=torch.float64)
    action, likelihood = squashed(mean, deviation, noise)
    law = torch.distributions.TransformedDistribution(
        torch.distributions.Normal(mean, deviation), torch.distributions.TanhTransform()
    )
    torch.testing.assert_close(law.log_prob(action).sum(-1), likelihood, rtol=0, atol=1e-10)
    assert action.max() < 0.99


def test_a_window_has_the_discounted_entropy_in_its_return():
    """Nothing else where rewards and critics are zero: equation 18 of Xing et al. 2025."""
    one = learner("shac", **SOFT, reward_scale=0.0)
    for weights in one.target.parameters():
        weights.data.zero_()
    objective, data = one.window()
    discount = 0.99 ** torch.arange(len(data["entropy"]))[:, None]
    expected = 0.1 * (discount * data["entropy"]).mean(0)
    torch.testing.assert_close(objective.detach(), expected, rtol=1e-5, atol=0, check_dtype=False)


def test_the_weight_of_the_entropy_follows_what_is_missing():
    """Where the deviation is large the weight falls, where it is small it rises."""
    for deviation, sign in ((0.5, -1), (0.02, 1)):
        one = learner("shac", **SOFT, deviation=deviation)
        weight = one.iteration(0.0)["weight"]
        assert (weight - 0.1) * sign > 0
        assert one.log_weight.item() == pytest.approx(math.log(weight), rel=1e-6)


def test_episodes_in_a_plane_go_on_with_the_same_bits():
    """Fingers near a ball: an env goes on as one that is restored, with the pairs of elements that
    are near each other now. An interval on, all of its beams is the same.
    """
    task = Task("grip", "torchbeam/GripperPlanar-v1", arguments={}, error="distance")
    env, other = (task.make(4, output="torch") for _ in range(2))
    env.reset(seed=3)
    actions = 2 * torch.rand(5, 4, 3, generator=torch.Generator().manual_seed(0)).double() - 1
    for action in actions[:4]:
        env.step(action)
    common.restore_environment(other, common.environment_state(env))
    for each in (env, other):
        each.step(actions[4])
    for name, value in vars(env.state.beam).items():
        if isinstance(value, torch.Tensor):
            assert torch.equal(value, getattr(other.state.beam, name)), name


@pytest.mark.parametrize(
    "name, task, settings",
    [
        ("ppo", TINY, {}),
        pytest.param("ppo", TINY, TAUGHT, marks=pytest.mark.long),  # of lessons, as SHAC's
        ("sac", TINY, {}),
        ("shac", TINY.varied(randomize=True, noise=0.01), {}),
        ("shac", TINY, SOFT),
        pytest.param("shac", TINY, TAUGHT, marks=pytest.mark.long),  # less than LQG has
        ("shac", TINY, {"teacher": "MPC(horizon=4)", "lessons": 3}),
        ("shac", TINY, {"teacher": "LQG(latency=2, disturbance=0.1)", "lessons": 3}),
    ],
)
def test_resume_is_bit_exact(name, task, settings, tmp_path):
    """A run that is stopped between two checkpoints and goes on ends with the bits of one that
    never was; also where beams change with the episode and sensors are noisy, and where it is
    stopped after two of three lessons, by a teacher that remembers nothing, its plan, or what it
    has given and estimated.
    """
    budget = common.Budget(steps=4 * 32)
    options = dict(episodes=2, final=2, progress=False, name="run")
    whole = common.train(
        learner(name, task, **settings), task, tmp_path / "whole", budget, **options
    )
    part = learner(name, task, **settings)
    steps, stop = part.iteration, iter(range(2))
    part.iteration = lambda done: (
        steps(done),
        pytest.fail("stopped") if next(stop, None) is None else None,
    )[0]
    with pytest.raises(pytest.fail.Exception):
        common.train(part, task, tmp_path / "part", budget, **options)
    assert (tmp_path / "part/run.checkpoint").exists()
    again = learner(name, task, **settings)
    resumed = common.train(again, task, tmp_path / "part", budget, **options)
    assert not (tmp_path / "part/run.checkpoint").exists()
    a, b = (load(tmp_path / where / "run.pt").state_dict() for where in ("whole", "part"))
    assert all(torch.equal(a[key], b[key]) for key in a)
    assert {**whole, "seconds": 0} == {**resumed, "seconds": 0}
    logs = [list(csv.DictReader(open(tmp_path / where / "run.csv"))) for where in ("whole", "part")]
    assert [row["validation_return"] for row in logs[0]] == [
        row["validation_return"] for row in logs[1]
    ]
    assert [int(row["iteration"]) for row in logs[1]] == [*range(5)]


def test_other_settings_start_anew(tmp_path):
    """A run that goes on under another rate or budget would be neither the one nor the other."""
    whole = common.Budget(steps=96)
    options = dict(episodes=2, final=2, progress=False, name="run")
    reference = common.train(learner("shac"), TINY, tmp_path / "whole", whole, **options)
    for index, (budget, settings) in enumerate(((whole, {"rate": 2e-2}), (common.Budget(64), {}))):
        part = learner("shac", **settings)
        calls = iter([part.iteration])
        part.iteration = lambda done, calls=calls: (
            next(calls, None) or (lambda done: pytest.fail("stopped"))
        )(done)
        with pytest.raises(pytest.fail.Exception):
            common.train(part, TINY, tmp_path / f"{index}", budget, **options)
        assert (tmp_path / f"{index}/run.checkpoint").exists()
        result = common.train(learner("shac"), TINY, tmp_path / f"{index}", whole, **options)
        assert {**result, "seconds": 0} == {**reference, "seconds": 0}


def test_the_best_policy_of_validation_is_kept(tmp_path, monkeypatch):
    """Scores rise and then fall: the policy between is saved and scored, the last one is named."""
    scores, seen = iter([-3.0, -1.0, -2.0, -4.0]), []
    monkeypatch.setattr(
        common,
        "validation",
        lambda task, policy, env: (
            seen.append({k: v.clone() for k, v in policy.state_dict().items()})
            or {"validation_return": next(scores)}
        ),
    )
    result = trained(tmp_path, steps=96)
    kept = load(tmp_path / "run.pt").state_dict()
    assert len(seen) == 4 and all(torch.equal(kept[key], seen[1][key].double()) for key in kept)
    assert result["chosen_steps"] == 32 and result["return"] != result["last_return"]


@pytest.mark.parametrize(
    "name, settings",
    [
        ("ppo", dict(num_envs=16, rate=5e-3)),
        (  # of 80 transitions, the five last intervals, it learns by chance or not at all
            "sac",
            dict(num_envs=16, rate=5e-3, warmup=192, target=0.03, updates=64, minibatch=64)
            | dict(replay=10_000),
        ),
        ("shac", dict(num_envs=8, rate=1e-2, falling=960)),
    ],
)
def test_learns(name, settings):
    """Ten updates on a coarse strip cut what held-out episodes cost by more than a tenth."""
    one = learner(name, horizon=12, **settings)
    before = evaluate(TINY, one.policy, 16)["return"]
    for k in range(10):
        one.iteration(k / 10)
    assert evaluate(TINY, one.policy, 16)["return"] > 0.9 * before


def test_the_value_takes_nothing_from_the_step_of_the_policy():
    """Gradients are scaled down to a norm, those of PPO's policy and value each by itself: a
    thousand times the value's weight makes the same policy.
    """
    light, heavy = (learner("ppo", value_weight=weight) for weight in (0.5, 500.0))
    for one in (light, heavy):
        one.iteration(0.0)
    for a, b in zip(light.policy.parameters(), heavy.policy.parameters(), strict=True):
        assert torch.equal(a, b)
    assert not torch.equal(light.value.network[0].weight, heavy.value.network[0].weight)


def test_what_the_value_of_ppo_learns_is_normalised_and_means_returns():
    """Rewards of -1000 and more a step: targets of mean 0 and variance 1. A value that says 0 then
    means the mean return, and what is made of a target again is a reward and the half of that, the
    discount.
    """
    one = learner("ppo", discount=0.5, trace=0.0)
    data = one.collect()
    data["reward"] = 300 * data["reward"] - 1000
    for x in one.advantages(data):
        assert x.mean().item() == pytest.approx(0, abs=1e-3)
        assert x.var(correction=0).item() == pytest.approx(1, rel=0.05)
    mean = one.returns.mean.clone()
    one.value = lambda seen: torch.zeros(seen.shape[:-1])
    target = one.advantages(data)[1]
    again = target * one.returns.variance.sqrt() + one.returns.mean
    torch.testing.assert_close(again, data["reward"].double() + 0.5 * mean, rtol=1e-5, atol=0)


@pytest.mark.parametrize("name", ["ppo", "shac"])
def test_lessons_make_a_policy_like_its_teacher(name):
    """Six windows: on held-out episodes it then loses less than a quarter of what lies between no
    action and LQR; its critic has learned beside it, and learning goes on from there.
    """
    one = learner(name, num_envs=16, horizon=12, teacher="LQR", lessons=6)
    before = [p.clone() for p in (one.value if name == "ppo" else one.critic).parameters()]
    for _ in range(6):
        figures = one.iteration(0.0)
    assert one.imitation.over and "imitation_error" in figures
    # each observation counts once
    assert one.policy.statistics.count.item() == pytest.approx(6 * one.batch, abs=1e-3)
    after = (one.value if name == "ppo" else one.critic).parameters()
    assert not any(torch.equal(a, b) for a, b in zip(before, after, strict=True))
    check_lessons(one.policy)
    assert "imitation_error" not in one.iteration(0.5)


def test_a_teacher_has_the_settings_that_are_named():
    one = learner("shac", teacher="LQR(effort=3.0, schedule=3)", lessons=1)
    env = one.env
    same, other = LQR(env, 3.0, schedule=3), LQR(env)
    for controller in (same, other):
        controller.begin(env)
    said = one.imitation.controller(env.state.observation)
    assert torch.equal(said, same(env.state.observation))
    assert not torch.equal(said, other(env.state.observation))


@pytest.mark.parametrize("name", ["ppo", "shac"])
def test_a_linear_shortcut_is_zero_at_first_learns_and_is_kept(name, tmp_path):
    one = learner(name, linear=True, teacher="LQR", lessons=1)
    observation = one.env.state.observation
    seen, network = one.policy.statistics(observation).float(), one.policy.network
    assert torch.equal(network(seen), network.layers(seen))
    for _ in range(2):
        before = network.linear.weight.clone()
        one.iteration(0.0)
        assert (network.linear.weight != before).all()
    save(one.policy, tmp_path / "policy.pt")
    after = load(tmp_path / "policy.pt")(observation)
    assert torch.equal(after, one.policy(observation))


def test_a_teacher_that_is_none_is_refused():
    for name in (
        *("search", "nobody", "Grasp", "LQR(0.1)", "LQR(effort=0.1", "LQR(weight=0.1)"),
        *("LQR(effort=print(1))", "LQR(effort=-1)", "LQR(**{'effort': 1})"),
    ):
        with pytest.raises(ValueError, match="was given"):
            learner("shac", teacher=name)


def test_numpy_and_torch_output_teach_the_same():
    """The same noise, the same episodes; numpy observations are rounded to float32."""
    a, b = learner("ppo", output="numpy"), learner("ppo", output="torch")
    for one in (a, b):
        one.data = one.collect()
    assert b.data["observation"].dtype == torch.float64
    for name in ("observation", "reward", "next", "likelihood"):
        torch.testing.assert_close(
            a.data[name].double(), b.data[name].double(), atol=1e-5, rtol=1e-5
        )
    assert torch.equal(a.data["over"], b.data["over"])


def test_the_value_of_a_time_limit_is_that_before_the_reset():
    """`next` of an episode's last step is its last observation, not the first of the one that
    follows.
    """
    for name in LEARNERS:
        one = learner(name, horizon=12)
        data = one.window()[1] if name == "shac" else one.collect()
        if name != "sac":
            assert data["over"][-1].all() and not data["over"][:-1].any()
        assert not data["terminated"].any()
        # displacement since the start of the episode
        moved = data["next"][-1, :, 2:4].abs().amax(-1)
        assert (moved > 0).all()
        torch.testing.assert_close(data["next"][:-1], data["observation"][1:])


def test_statistics_are_those_of_all_data():
    x = (
        torch.randn(100, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        * torch.tensor([1.0, 5.0, 0.1])
        + 2
    )
    seen = Statistics(3)
    for part in x.split((10, 60, 30)):
        seen.update(part)
    # the prior counts 1e-4 samples
    torch.testing.assert_close(seen.mean, x.mean(0), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(seen.variance, x.var(0, correction=0), rtol=1e-3, atol=1e-4)


def test_policy_from_its_file(tmp_path):
    policy = Policy((17, 16, 2), squash=True)
    policy.statistics.update(torch.rand(10, 17))
    save(policy, tmp_path / "policy.pt", task="reach", scores={"return": -1.0})
    loaded = load(tmp_path / "policy.pt")
    observation = np.random.default_rng(0).normal(size=(5, 17)).astype(np.float32)
    action = loaded(observation)
    assert action.shape == (5, 2) and isinstance(action, np.ndarray) and (np.abs(action) <= 1).all()
    assert np.array_equal(action, policy(observation)) and np.array_equal(
        action, loaded(torch.as_tensor(observation)).numpy()
    )
    assert loaded.about == {"task": "reach", "scores": {"return": -1.0}}


class Evil:
    """A pickle that runs code where it is loaded as it was written."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


def test_files_are_data_and_nothing_else(tmp_path):
    """What a learner writes holds tensors and plain data alone; a malicious, damaged, foreign or
    missing file is refused in a sentence, as policy and as checkpoint, and nothing in it is run.
    """
    for name in LEARNERS:
        torch.save(learner(name).state_dict(), tmp_path / "state")
        torch.load(tmp_path / "state", weights_only=True)
    trap, good = tmp_path / "trap", (tmp_path / "state").read_bytes()
    for content, sentence in (
        (Evil(trap), "holds more than tensors"),
        ({"learner": Evil(trap)}, "holds more than tensors"),
        (b"not a file of torch", "was given for a"),
        (b"", "was given for a"),
        (good[:500], "cannot be read"),
        ({"weights": 1}, "has no"),
        ([1], "has no"),
    ):
        for path in (tmp_path / "run.checkpoint", tmp_path / "policy.pt"):
            path.write_bytes(content) if isinstance(content, bytes) else torch.save(content, path)
        with pytest.raises(
            ValueError, match=r"run.checkpoint' was given for a checkpoint, and "
        ) as said:
            trained(tmp_path, steps=32)
        assert sentence in str(said.value)
        with pytest.raises(ValueError, match=sentence):
            load(tmp_path / "policy.pt")
    assert not trap.exists()
    with pytest.raises(ValueError, match="is not there"):
        load(tmp_path / "none.pt")


def test_what_does_not_fit_is_refused(tmp_path):
    """A checkpoint that says it is of these settings and holds another learner, other sizes, more
    environments; a policy with other weights.
    """
    settings = {**vars(learner("shac").arguments), "budget": {"steps": 32, "minutes": None}}
    settings["task"] = repr(TINY)
    rest = {"iteration": 1, "steps": 32, "seconds": 1.0, "rows": 1, "best": {}}
    rest["settings"] = settings
    for other in (learner("ppo"), learner("shac", hidden=(8,)), learner("shac", num_envs=3)):
        torch.save({"learner": other.state_dict(), **rest}, tmp_path / "run.checkpoint")
        with pytest.raises(
            ValueError, match=r"run.checkpoint' was given, which does not fit this learner"
        ):
            trained(tmp_path, steps=32)
    policy = Policy((17, 16, 2), squash=True)
    for weights in ({}, {**policy.state_dict(), "log_deviation": torch.zeros(3)}):
        torch.save({"shape": policy.shape, "weights": weights, "about": {}}, tmp_path / "policy.pt")
        with pytest.raises(ValueError, match="weights fit no policy"):
            load(tmp_path / "policy.pt")


def test_commands_refuse_first(tmp_path, capsys):
    """A folder below a file, a policy that is none, one of an unknown task: a sentence and the
    status 2.
    """
    file = tmp_path / "file"
    file.write_text("")
    save(Policy((17, 16, 2), squash=True), tmp_path / "policy.pt", task="nonsense", arguments={})
    for call, sentence in (
        (
            lambda: common.main(["--out", f"{file}/x"], shac.Arguments, shac.SHAC, {}),
            "cannot be written",
        ),
        (lambda: results.main(["--out", f"{file}/x"]), "cannot be written"),
        (lambda: evaluation([str(file)]), "was given for a policy"),
        (lambda: evaluation([str(tmp_path / "policy.pt")]), "names no environment of this release"),
    ):
        with pytest.raises(SystemExit) as end:
            call()
        assert end.value.code == 2 and sentence in capsys.readouterr().err


def test_arguments_are_documented():
    for module in (ppo, sac, shac, student):
        names = {field.name for field in common.fields(module.Arguments)}
        assert set(common.documented(module.Arguments)) == names


def learned(folder, monkeypatch, task, text):
    """The policy of a few steps of PPO on the task MODULE:NAME, of a module with this text."""
    module, _, name = task.partition(":")
    (folder / f"{module}.py").write_text(text)
    monkeypatch.syspath_prepend(folder)
    given = ["--task", task, "--budget", "16", "--num-envs", "4", "--horizon", "4"]
    common.main([*given, "--hidden", "(8,)", "--out", str(folder)], ppo.Arguments, ppo.PPO, {})
    return str(folder / f"{name}-ppo-0.pt")


def test_a_task_of_ones_own(tmp_path, capsys, monkeypatch):
    """From its module, on the command line; its policy is scored by what the file says of it, also
    where a task of that name is another one now.
    """
    policy = learned(
        tmp_path,
        monkeypatch,
        "own_task:lift",
        "from training.tuned import Task\n"
        "lift = Task('lift', 'torchbeam/TipReachPlanar-v1', "
        "dict(elements=2, substeps=1, max_episode_steps=4), tolerance=0.5, hold=2)\n",
    )
    assert evaluation([policy, "--episodes", "2"]) == 0
    said = json.loads(capsys.readouterr().out.split("\n", 2)[2])
    assert said["episodes"] == 2 and load(policy).about["tolerance"] == 0.5
    with monkeypatch.context() as other:
        other.setitem(TASKS, "lift", TASKS["track"])
        assert evaluation([policy, "--episodes", "2"]) == 0
    assert json.loads(capsys.readouterr().out) == said
    for wrong, sentence in (
        ("lift", "one of reach, "),
        ("own_task:drop", "cannot be had"),
        ("no_module:lift", "cannot be had"),
        ("own_task:Task", "which is a type"),
    ):
        with pytest.raises(SystemExit):
            common.main(["--task", wrong], ppo.Arguments, ppo.PPO, {})
        assert sentence in capsys.readouterr().err


@pytest.mark.parametrize("prefix", ["", "own/"])
def test_what_a_file_names_is_not_imported(tmp_path, capsys, monkeypatch, prefix):
    """A module whose import would leave a file behind, as the module of an env: neither by us nor
    by Gymnasium; named by the user it is imported.
    """
    (tmp_path / f"of_others{len(prefix)}.py").write_text(
        "from pathlib import Path\nfrom training.tuned import TASKS\n"
        "Path(__file__).with_suffix('.ran').touch()\nreach = TASKS['reach']\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    module, policy = f"of_others{len(prefix)}", str(tmp_path / "policy.pt")
    env = f"{module}:{prefix}TipReachPlanar-v1"
    about = {"task" if key == "name" else key: x for key, x in vars(TASKS["reach"]).items()}
    space = TASKS["reach"].make(1).single_observation_space.shape
    save(Policy([*space, 8, 1], squash=True), policy, **{**about, "env": env})
    with pytest.raises(SystemExit):
        evaluation([policy, "--episodes", "2"])
    assert "names no environment of this release: --task is wanted" in capsys.readouterr().err
    assert not (tmp_path / f"{module}.ran").exists()
    assert evaluation([policy, "--episodes", "2", "--task", f"{module}:reach"]) == 0
    assert (tmp_path / f"{module}.ran").exists()


def test_a_task_with_an_object_among_its_arguments(tmp_path, capsys, monkeypatch):
    """Its policy can be read, and scored where the task is named: nothing in a file is run."""
    policy = learned(
        tmp_path,
        monkeypatch,
        "bent_task:bent",
        "import torchbeam as tb\nfrom training.tuned import Task\n"
        "beam = tb.Beam.straight(1.0, 2, tb.Section.circle(0.01, 1e8, 0.4, 1e3))\n"
        "bent = Task('bent', 'torchbeam/TipReachPlanar-v1', "
        "dict(beam=beam, substeps=1, max_episode_steps=4))\n",
    )
    assert f"policy: {policy}" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        evaluation([policy])
    assert "--task MODULE:NAME is wanted too" in capsys.readouterr().err
    assert evaluation([policy, "--task", "bent_task:bent", "--episodes", "2"]) == 0
    assert json.loads(capsys.readouterr().out)["episodes"] == 2


@pytest.mark.parametrize(
    "name",
    [
        "ppo",
        "sac",
        "shac",
        "student",
        "sb3",
        "skrl",
        "results",
        "times",
        "variance",
        "evaluate",
        "cards",
    ],
)
def test_help_helps(name, capsys):
    """Of every script."""
    for library, of in (("stable_baselines3", "sb3"), ("skrl", "skrl")):
        if name == of:
            pytest.importorskip(library)
    module = importlib.import_module(f"training.{name}")
    learner = getattr(module, "Student" if name == "student" else name.upper(), None)
    own = (module.Arguments, learner, {}) if learner else ()
    with pytest.raises(SystemExit) as end:
        module.main(["--help"], *own)
    assert end.value.code == 0
    assert f"usage: python -m training.{name}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (["--budget", "0"], "a number above 0 is wanted"),
        (["--budget", "-1"], "a number above 0 is wanted"),
        (["--budget", "many"], "invalid int value"),
        (["--minutes", "0"], "a number above 0 is wanted"),
        (["--teacher", "Nobody"], "a controller of torchbeam_envs.baselines"),
        (["--seed", "50"], "0 to 49 are wanted"),
    ],
)
def test_wrong_options_are_refused_in_a_sentence(given, sentence, tmp_path, capsys):
    with pytest.raises(SystemExit):
        common.main([*given, "--out", str(tmp_path)], shac.Arguments, shac.SHAC, {})
    assert sentence in capsys.readouterr().err


def test_a_checkpoint_of_another_task_is_not_gone_on_from(tmp_path):
    """Of the same name and the same sizes."""
    options = dict(final=2, episodes=2, progress=False)
    one = learner("shac")
    state = {"iteration": 1, "steps": 32, "seconds": 1.0, "rows": 1, "best": {}}
    state |= {"learner": one.state_dict(), "best": vars(common.Best())}
    budget = common.Budget(steps=64)
    other = TINY.varied(substeps=2)
    settings = {**vars(one.arguments), "budget": vars(budget)}
    torch.save(
        {**state, "settings": {**settings, "task": repr(other)}}, tmp_path / "run.checkpoint"
    )
    assert common.train(one, TINY, tmp_path, budget, **options)["iterations"] == 2
    with open(tmp_path / "run.csv", newline="") as file:
        assert [row["steps"] for row in csv.DictReader(file)] == ["0", "32", "64"]


def test_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(TASKS, "reach", TINY)
    monkeypatch.setattr(
        common,
        "evaluate",
        lambda *given, **more: {"return": 0.0, "success": 0.0, "final_error": 0.0},
    )
    common.main(
        [
            "--budget",
            "32",
            "--num-envs",
            "4",
            "--horizon",
            "8",
            "--hidden",
            "(8,)",
            "--seed",
            "3",
            "--out",
            str(tmp_path),
        ],
        shac.Arguments,
        shac.SHAC,
        {},
    )
    assert (
        load(tmp_path / "tiny-shac-3.pt").shape["sizes"] == [11, 8, 1]
        and "steps 32" in capsys.readouterr().out
    )


def test_scores_of_no_episode_are_refused(tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        evaluation([str(tmp_path / "none.pt"), "--episodes", "0"])
    said = capsys.readouterr().err
    assert ended.value.code == 2 and "0 was given; a number above 0 is wanted" in said


ARM = Task(
    "follow",
    "torchbeam/FollowTargetPlanar-v1",
    dict(elements=5, substeps=1, max_episode_steps=8),
    tolerance=0.4,
)


def test_shares_of_time_are_those_of_the_rewards():
    """By counting; and by returns, as the bonus of FollowTarget is 2 within 0.05 m, 0.5 within
    0.1 m. No action.
    """
    env = make(ARM, 32)
    env.reset(seed=HELD_OUT)
    distances = torch.stack([env.step(torch.zeros(32, 5))[4]["distance"] for _ in range(8)])
    found = evaluate(ARM, Zero(), 32)
    assert 0 < found["within_half"] < found["within"] < 1
    assert found["within"] == pytest.approx((distances <= 0.4).double().mean().item())
    assert found["within_half"] == pytest.approx((distances <= 0.2).double().mean().item())
    near = evaluate(replace(ARM, tolerance=0.1), Zero(), 32)
    bonus = 8 * (0.5 * near["within"] + 1.5 * near["within_half"])
    assert near["return"] == pytest.approx(bonus - distances.square().sum(0).mean().item())


def test_after_an_early_end_nothing_is_within():
    """Of a tolerance that holds everything, the share of time is that before the strip is lost."""
    task = replace(TASKS["flutter"], tolerance=100.0)
    env = make(task, 8)
    env.reset(seed=HELD_OUT)
    ends, over = [], False
    while not over:
        _, _, terminated, truncated, _ = env.step(torch.zeros(8, 1))
        ends.append(terminated)
        over = (terminated | truncated).all()
    share = 1 - torch.stack(ends).double().mean().item()
    assert share < 1
    assert evaluate(task, Zero(), 8)["within"] == pytest.approx(share)


def test_a_smooth_reward_is_learned_from_alone(tmp_path):
    """Scores are of the reward as it is."""
    one = learner("shac", ARM, smooth=0.03)
    assert one.env.task.config.smooth == 0.03
    result = common.train(
        one, ARM, tmp_path, common.Budget(64), final=4, episodes=4, progress=False
    )
    policy = load(tmp_path / "run.pt")
    assert result["return"] == evaluate(ARM, policy, 4)["return"]
    assert result["return"] != evaluate(ARM.varied(smooth=0.03), policy, 4)["return"]


@pytest.mark.parametrize(
    ("iterations", "validated"),
    [(160, [0, 1, 2, 4, *range(8, 161, 8)]), (40, [0, 1, *range(2, 41, 2)]), (7, range(8))],
)
def test_validations_are_at_shares_of_the_budget(tmp_path, monkeypatch, iterations, validated):
    """Closer together at first; after each iteration where it has few; whatever these do."""
    options = dict(final=2, episodes=2, progress=False)
    budget, one = common.Budget(steps=iterations * 32), learner("shac", TINY)
    monkeypatch.setattr(one, "iteration", lambda done: {})
    monkeypatch.setattr(common, "validation", lambda *given: {"validation_return": 0.0})
    common.train(one, TINY, tmp_path, budget, **options)
    with open(tmp_path / "run.csv", newline="") as file:
        steps = [int(row["steps"]) for row in csv.DictReader(file)]
    assert steps == [32 * iteration for iteration in validated]
