"""Policies that remember: what they can do that others cannot, whose memory is whose, files,
sequences, lessons; and frames, which are the learner's.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box

from tests.cases.tiny_task import TINY
from tests.cases.training_checks import check_gradient, check_lessons
from training import common, ppo, results, sac, shac, student, tuned
from training.evaluate import main as evaluation
from training.policies import Policy, load, save
from training.tuned import TASKS

torch.set_num_threads(1)
LEARNERS = {
    "ppo": (ppo.PPO, ppo.Arguments),
    "sac": (sac.SAC, sac.Arguments),
    "shac": (shac.SHAC, shac.Arguments),
    "student": (student.Student, student.Arguments),
}

OWN = {
    "sac": {"warmup": 32, "updates": 4, "minibatch": 16, "replay": 80, "window": 4, "burn": 2},
    "student": {"teacher": "LQR", "lessons": 3},
}


def learner(name, task=TINY, **settings):
    made, arguments = LEARNERS[name]
    small = {"num_envs": 4, "horizon": 8, "hidden": (16,), "memory": 4}
    small |= OWN.get(name, {})
    return made(task, arguments(**{**small, **settings}))


@dataclass
class Shown:
    """Episodes of `Recall`."""

    steps: torch.Tensor
    goal: torch.Tensor

    @property
    def observation(self):
        return torch.where(self.steps == 0, self.goal, 0.0)[:, None]


class Recall:
    """A number, 0.8 or -0.8, is shown in the first of five intervals, then 0. The reward of each is
    minus the square of the action's distance from it: who remembers nothing does best by 0 in the
    four others, a mean of -0.512.
    """

    LAST = 5

    def __init__(self, num_envs):
        self.num_envs, self.max_episode_steps = num_envs, self.LAST
        self.single_observation_space, self.single_action_space = Box(-1, 1, (1,)), Box(-1, 1, (1,))
        self.action_space = Box(-1, 1, (num_envs, 1))

    def reset(self, seed=0):
        self.generator = torch.Generator().manual_seed(seed)
        self.state = Shown(torch.zeros(self.num_envs, dtype=torch.int64), self.drawn())
        return self.state.observation, {}

    def drawn(self):
        coin = torch.randint(2, (self.num_envs,), generator=self.generator)
        return 1.6 * coin.double() - 0.8

    def initialize_trajectory(self):
        return self.state.observation

    def step(self, action):
        reward = -(action[:, 0].double() - self.state.goal).square()
        steps = self.state.steps + 1
        truncated = steps == self.LAST
        last = Shown(steps, self.state.goal).observation
        goal = torch.where(truncated, self.drawn(), self.state.goal)
        self.state = Shown(torch.where(truncated, 0, steps), goal)
        return (
            self.state.observation, reward, torch.zeros_like(truncated), truncated,
            {"final_obs": last},
        )  # fmt: skip


class RecallTask:
    def seen(self, frames):
        return self

    def make(self, num_envs, **_):
        return Recall(num_envs)


@torch.no_grad()
def recalled(policy):
    """Mean reward of 200 intervals; the policy is told of no reset, it sees it."""
    env, total = Recall(64), 0.0
    observation, _ = env.reset(seed=5)
    policy.begin(env)
    for _ in range(200):
        observation, reward, *_ = env.step(policy(observation))
        total += reward.mean().item() / 200
    return total


@pytest.mark.parametrize(
    ("name", "iterations", "settings"),
    [
        ("shac", 20, dict(rate=3e-2, reward_scale=1.0, critic_rate=1e-2, critic_epochs=2)),
        ("ppo", 15, dict(rate=2e-2, output="torch", minibatches=2, divergence=0.1)),
        (
            "sac",
            20,
            dict(rate=2e-2, reward_scale=1.0, target=0.1, temperature=0.02, replay=10_000)
            | dict(warmup=160, updates=8, minibatch=80, window=5, burn=2),
        ),
    ],
)
def test_what_was_shown_once_is_remembered(name, iterations, settings):
    """With a GRU far beyond what is to be had without, in as many updates."""
    score = {}
    for memory in (8, 0):
        small = dict(num_envs=16, horizon=5, memory=memory, discount=0.5)
        one = learner(name, RecallTask(), **small, **settings)
        for k in range(iterations):
            one.iteration(k / iterations)
        score[memory] = recalled(one.policy)
    assert score[0] < -0.5
    assert score[8] > -0.1


def policy_with_memory(seed=0, squash=True):
    """Of weights that make its memory felt."""
    torch.manual_seed(seed)
    policy = Policy((11, 16, 1), squash=squash, memory=6)
    policy.statistics.update(torch.rand(50, 11) - 0.5)
    for weight in policy.network[-1].parameters():
        torch.nn.init.normal_(weight)
    return policy


def test_lanes_that_begin_anew_forget_and_no_others():
    """Twelve intervals of four episodes, of which two are reset by hand after five, by the mask:
    their actions are then those of a policy that begins, and the others' are what they were. In the
    end all are reset by the env, and nobody remembers anything.
    """
    policy, env = policy_with_memory(), TINY.make(4, output="torch", autoreset_mode="SameStep")
    mask = np.array([False, True, False, True])
    observation, _ = env.reset(seed=3)
    policy.begin(env)
    seen, done = [], []
    for k in range(13):
        if k == 5:
            observation, _ = env.reset(options={"reset_mask": mask})
        seen.append(observation)
        done.append(action := policy(observation))
        observation, *_ = env.step(action)
    assert (env.state.steps == torch.tensor([1, 8, 1, 8])).all()
    whole, late, last = (policy_with_memory() for _ in range(3))
    alone = {
        who: [who(x) for x in seen[since:]] for who, since in ((whole, 0), (late, 5), (last, 12))
    }
    for k in range(13):
        kept = alone[last][k - 12] if k >= 12 else alone[whole][k]
        torch.testing.assert_close(done[k][~mask], kept[~mask], rtol=0, atol=1e-6)
        anew = alone[late][k - 5] if k >= 5 else alone[whole][k]
        torch.testing.assert_close(done[k][mask], anew[mask], rtol=0, atol=1e-6)
    assert (alone[whole][8] - alone[late][3])[mask].abs().min() > 1e-4  # memory is felt
    assert (alone[whole][12] - alone[last][0]).abs().min() > 1e-4


def test_of_other_envs_the_user_says_which_lanes_begin():
    policy, other = policy_with_memory(), policy_with_memory()
    x = torch.rand(3, 4, 11)
    for seen in x[:2]:
        policy(seen), other(seen)
    policy.restart(torch.tensor([True, False, False, False]))
    a, b, fresh = policy(x[2]), other(x[2]), policy_with_memory()(x[2])
    assert torch.equal(a[1:], b[1:]) and torch.equal(a[:1], fresh[:1])
    assert not torch.equal(a[:1], b[:1])
    with pytest.raises(ValueError, match="3 observations were given to a policy that remembers 4"):
        policy(x[0, :3])
    policy.begin()
    assert policy(x[0, 0].numpy()).shape == (1,)


def test_an_observation_of_other_numbers_is_refused():
    for policy in (policy_with_memory(), Policy((11, 16, 1), squash=True)):
        for x in (torch.zeros(2, 44), torch.tensor(1.0)):
            with pytest.raises(ValueError, match=r"\(..., 11\) are wanted: those of the env"):
                policy(x)


def test_a_file_of_before_says_its_frames(tmp_path, capsys, monkeypatch):
    """Among the arguments of its environment: it is scored as it says, and of a task that is named
    with as many.
    """
    monkeypatch.setitem(TASKS, "tiny", TINY)
    about = {"task" if key == "name" else key: x for key, x in vars(TINY.seen(2)).items()}
    save(Policy((22, 8, 1), squash=True), tmp_path / "old.pt", **about)
    for more in ([], ["--task", "tiny"]):
        assert evaluation([str(tmp_path / "old.pt"), "--episodes", "2", *more]) == 0
        assert json.loads(capsys.readouterr().out)["episodes"] == 2


def test_a_file_gives_the_same_actions(tmp_path):
    policy = policy_with_memory()
    save(policy, tmp_path / "policy.pt", task="reach")
    loaded = load(tmp_path / "policy.pt")
    assert loaded.memory == 6
    for seen in torch.rand(5, 3, 11):
        assert torch.equal(policy(seen), loaded(seen))


def test_a_sequence_in_parts_is_the_whole_and_is_the_steps():
    """Of ten observations of three episodes, one of which ends within, and all at once after five:
    in one call, in two, and one by one. To 1e-6: float32 by other routes.
    """
    policy = policy_with_memory()
    x, over = torch.rand(10, 3, 11), torch.zeros(10, 3, dtype=torch.bool)
    over[2, 1], over[4] = True, True
    start = torch.rand(3, 6, dtype=torch.float32)
    whole = policy.see_all(x, start, over)
    memory, steps = start, []
    for k in range(10):
        features, memory = policy.see(x[k], memory)
        memory = torch.where(over[k][:, None], 0.0, memory)
        steps.append(features)
        if k == 6:
            middle = memory
    parts = torch.cat(
        (policy.see_all(x[:7], start, over[:7]), policy.see_all(x[7:], middle, over[7:]))
    )
    for other in (torch.stack(steps), parts):
        torch.testing.assert_close(whole, other, rtol=0, atol=1e-6)
    ahead = policy.see_next(whole, x.roll(-1, 0))
    going = ~over[:-1]
    torch.testing.assert_close(ahead[:-1][going], whole[1:][going], rtol=0, atol=1e-6)
    gone = policy.see(x[3], policy.blank(3))[0]
    torch.testing.assert_close(whole[3, 1], gone[1], rtol=0, atol=1e-6)


def test_ppo_sees_its_windows_as_it_played_them():
    """The likelihood of what it did, episodes' ends within the second window, through sequences: to
    1e-5 in float32.
    """
    one = learner("ppo", output="torch")
    for parameter in one.policy.network[-1].parameters():
        torch.nn.init.normal_(parameter)
    for _ in range(2):
        data = one.collect()
    assert data["over"].any() and data["memory"][0].abs().min() > 0
    played = []
    for part in one.minibatches(data):
        features = one.policy.see_all(part["observation"], part["memory"][0], part["over"])
        likelihood = one.policy.distribution(features).log_prob(part["action"]).sum(-1)
        torch.testing.assert_close(likelihood, part["likelihood"], rtol=0, atol=1e-5)
        played.append(features.shape[:2])
    assert played == [(8, 1)] * 4


def test_sac_draws_the_past_as_it_was():
    """Of a ring of 80 transitions that 96 have gone through, with episodes' ends: windows are of
    one lane, one interval after the other, and what is remembered after the burn-in is what was
    then, to 1e-6 in float32. After other weights it is what they would have remembered from there.
    """
    one = learner("sac", minibatch=400)
    for _ in range(3):
        one.remember(one.collect())
    assert one.replay["over"].any() and one.replay["memory"].any()
    data = one.draw()
    assert data["observation"].shape[:2] == (6, 100) and data["over"].any()
    going = ~data["over"][:-1]
    following = data["next"][:-1] == data["observation"][1:]
    assert following[going].all() and not following[~going].all()
    torch.testing.assert_close(one.brought_up(data), data["memory"][2], rtol=0, atol=1e-6)
    oldest = one.replay["observation"].roll(-(one.seen // 4) % 20, 0)[0]  # where 24 rows end
    assert (data["observation"][0][:, None] == oldest).all(-1).any()
    for weight in one.policy.recurrent.parameters():
        torch.nn.init.normal_(weight)
    now, memory = one.brought_up(data), data["memory"][0]
    features = one.policy.see_all(data["observation"][:2], memory, data["over"][:2])
    after = torch.where(data["over"][1][:, None], 0.0, features[-1, :, one.policy.observed :])
    torch.testing.assert_close(now, after, rtol=0, atol=1e-6)
    assert (now - data["memory"][2]).abs().max() > 0.1


def test_sac_wants_room_for_what_it_draws_and_collects():
    """Windows of six intervals with a memory, and rounds of eight or two, of four environments."""
    for horizon, least in ((8, 32), (2, 24)):
        with pytest.raises(ValueError, match=f"replay = {least - 1} was .* least {least} is want"):
            learner("sac", horizon=horizon, replay=least - 1)
        one = learner("sac", horizon=horizon, replay=least)
        while one.seen < 64:
            row = one.iteration(0.0)
    assert row["value_error"] > 0


def test_gradient_of_a_window_goes_through_the_memory():
    """16 steps with episodes' ends: central differences in two directions, in float64, 1e-6 as
    without a memory. What the critic makes of the memory is not differentiated: here it makes
    nothing of it.
    """
    one = learner("shac", horizon=16, num_envs=2)
    for part in (one.policy, one.target):
        part.double()
    one.target[0].network[0].weight.data[:, one.policy.observed :] = 0
    memory = torch.rand(2, 4)
    start, noise = common.environment_state(one.env), one.generator.get_state()

    def objective():
        common.restore_environment(one.env, start)
        one.generator.set_state(noise)
        one.memory = memory
        return one.window()[0].mean()

    check_gradient(objective, [*one.policy.parameters()])


def test_the_critic_is_not_pleased_by_the_memory():
    """No gradient reaches the recurrent unit through what the critic makes of it."""
    policy = policy_with_memory()
    x = torch.rand(2, 11).requires_grad_()
    features, _ = policy.see(x, torch.rand(2, 6, dtype=torch.float32))
    policy.held(features).sum().backward()
    assert not any(weight.grad.any() for weight in policy.recurrent.parameters())
    assert (x.grad != 0).all()


@pytest.mark.parametrize(
    ("name", "settings"), [("ppo", {}), ("sac", {}), ("shac", {"average": 3}), ("student", {})]
)
def test_a_stopped_run_ends_in_the_same_bits(name, settings, tmp_path):
    """Stopped between two checkpoints; episodes of twelve intervals in windows of eight: what is
    remembered where it stops goes on.
    """
    budget, task = common.Budget(steps=4 * 32), TINY.varied(randomize=True, noise=0.01)
    options = dict(episodes=2, final=2, progress=False, name="run")
    whole = common.train(
        learner(name, task, **settings), task, tmp_path / "whole", budget, **options
    )
    part = learner(name, task, **settings)
    steps, stop = part.iteration, iter(range(3))

    def iteration(done):
        return pytest.fail("stopped") if next(stop, None) is None else steps(done)

    part.iteration = iteration
    with pytest.raises(pytest.fail.Exception):
        common.train(part, task, tmp_path / "part", budget, **options)
    resumed = common.train(
        learner(name, task, **settings), task, tmp_path / "part", budget, **options
    )
    a, b = (load(tmp_path / where / "run.pt").state_dict() for where in ("whole", "part"))
    assert all(torch.equal(a[key], b[key]) for key in a)
    assert {**whole, "seconds": 0} == {**resumed, "seconds": 0}


def test_a_student_does_as_its_teacher():
    """Eight lessons by LQR, the last four played by the student alone: on held-out episodes it
    loses less than a quarter of what lies between no action and LQR.
    """
    one = learner("student", num_envs=16, horizon=12, lessons=4, memory=16)
    for k in range(8):
        figures = one.iteration(k / 8)
    assert one.imitation.done == 8 and figures["imitation_error"] < 0.02
    check_lessons(one.policy)


def test_lessons_at_another_pace_are_of_longer_intervals():
    """Three of the task's intervals in one, and a third of an episode's count of them, rounded up:
    what it is scored on stays as it is.
    """
    own = TINY.make(1).unwrapped
    one = learner("student", pace=3)
    of_task, of_lessons = own.config, one.env.config
    assert of_lessons.control_interval == pytest.approx(3 * of_task.control_interval)
    assert of_lessons.max_episode_steps == -(-of_task.max_episode_steps // 3)
    assert learner("student").env.config.control_interval == of_task.control_interval


@pytest.mark.parametrize("name", ["ppo", "shac"])
def test_learning_goes_on_from_lessons_with_a_memory(name):
    one = learner(name, num_envs=8, horizon=12, teacher="LQR", lessons=2)
    for k in range(4):
        figures = one.iteration(k / 4)
        assert ("imitation_error" in figures) == (k < 2)
    assert all(np.isfinite(value) for value in figures.values()) and not one.imitation.seen


def test_shac_keeps_an_average_of_its_weights():
    """In three updates after two lessons, by their definition: x <- x + (w - x)/4 of each weight
    from where the lessons ended. The normalisation of observations stays as the lessons left it;
    without them it goes on, and is the actor's. Over one update it is the actor itself.
    """
    one = learner("shac", teacher="LQR", lessons=2, average=4)
    for _ in range(2):
        one.iteration(0.0)
    kept = [w.detach().clone() for w in one.actor.parameters()]
    seen = one.actor.statistics.count.item()
    for _ in range(3):
        one.iteration(0.0)
        kept = [x + (w.detach() - x) / 4 for x, w in zip(kept, one.actor.parameters(), strict=True)]
    for x, w in zip(kept, one.policy.parameters(), strict=True):
        torch.testing.assert_close(x, w.detach(), rtol=1e-6, atol=1e-7)
    assert one.policy.statistics.count.item() == seen == one.actor.statistics.count.item()
    apart = [
        (a - b).abs().max()
        for a, b in zip(one.policy.parameters(), one.actor.parameters(), strict=True)
    ]
    assert max(apart) > 1e-3
    for average in (0, 1):
        same = learner("shac", average=average)
        for _ in range(2):
            same.iteration(0.0)
        assert (same.policy is same.actor) == (average == 0)
        a, b = same.policy.state_dict(), same.actor.state_dict()
        assert all(torch.equal(a[key], b[key]) for key in a)
        assert a["statistics.count"] > 64


def test_lessons_are_of_whole_episodes():
    """The policy is asked for what was said from the first interval of an episode to its last, with
    nothing remembered at its start, and nothing of the next one.
    """
    one = learner("student", num_envs=3, horizon=30, lessons=1, updates=1)
    one.collect()
    lesson, asked = one.imitation, []
    lesson.seen, lesson.said, lesson.first = (
        [torch.cat(rows)] for rows in (lesson.seen, lesson.said, lesson.first)
    )
    # a number that tells interval and lane, as what was said
    lesson.said = [torch.arange(90.0)[:, None]]
    lesson.policy.act = lambda features: (
        asked.append(features) or torch.zeros(*features.shape[:2], 1)
    )
    error = lesson._episodes(torch.Generator().manual_seed(0)).item()
    assert asked[0].shape[:2] == (12, 32)
    starts = lesson.first[0].unflatten(0, (-1, 3)).nonzero()
    draw = torch.Generator().manual_seed(0)
    begin, lane = starts[torch.randint(len(starts), (32,), generator=draw)].mT
    said = [3 * t + i for b, i in zip(begin, lane, strict=True) for t in range(b, min(b + 12, 30))]
    assert len(said) < 12 * 32  # the last episodes are not at their end
    assert error == pytest.approx(torch.stack(said).double().square().mean().item())


def test_rates_of_shac_follow_steps_and_not_the_budget():
    """Runs of other budgets begin with the same bits; rates fall to a tenth and stay there."""
    ends = []
    for shares in ((0.0, 0.5, 0.9), (0.0, 0.001, 0.002)):
        one = learner("shac", memory=0, falling=96)
        for done in shares:
            one.iteration(done)
        ends.append(one.policy.state_dict())
    assert all(torch.equal(ends[0][key], ends[1][key]) for key in ends[0])
    for _ in range(2):
        one.iteration(0.0)
        rates = [x.param_groups[0]["lr"] for x in (one.optimizer, one.critic_optimizer)]
        assert rates == pytest.approx([1e-3, 2e-4])
    for name in (*tuned.DEFAULT, *results.SPACE):  # as they fell in the study of before
        settings = shac.Arguments(**tuned.SHAC.get(name, {}))
        assert settings.falling == tuned.budget("shac", name)


def test_frames_are_the_learners(tmp_path, capsys, monkeypatch):
    """No task of the study has any; a file says how many its policy sees, also where the task is
    named; runs of libraries see as many as ours.
    """
    assert not any("frames" in task.arguments for task in TASKS.values())
    monkeypatch.setitem(TASKS, "tiny", TINY)
    for name, frames in (("shac", 3), ("ppo", 0)):
        one = learner(name, frames=frames, memory=0)
        assert one.policy.observed == 11 * (frames or 1)
        options = dict(name=name, episodes=2, final=2, progress=False)
        result = common.train(one, TINY, tmp_path, common.Budget(steps=32), **options)
        policy = load(tmp_path / f"{name}.pt")
        assert policy.about["arguments"].get("frames", 0) == policy.about["frames"] == frames
        for more in ([], ["--task", "tiny"]):
            assert evaluation([str(tmp_path / f"{name}.pt"), "--episodes", "2", *more]) == 0
            said = json.loads(capsys.readouterr().out)
            assert said["return"] == pytest.approx(result["return"], rel=1e-12)
    for algorithm, seen in (("sac", 4), ("shac", 12), ("sb3-sac", 4), ("skrl-ppo", 4)):
        assert results.Run("flutter-uncertain", algorithm, 0).settings["frames"] == seen
    assert results.Run("reach", "sb3-ppo", 0).settings["frames"] == 0


def test_runs_of_before_are_not_made_again():
    """Of the study that is stored: frames among the arguments of their environment, rates that fell
    over the budget. PPO of flutter saw twelve frames, and four are wanted.
    """
    folder = Path(results.__file__).parents[1] / "docs/results/learning/runs"

    def there(task, algorithm, seed=9, share=1.0):
        run = results.Run(task, algorithm, seed)
        steps = None if seed is None else round(share * tuned.budget(algorithm, task))
        return results.is_made(run, folder, common.Budget(steps), 256)

    for task in ("reach", "track-uncertain", "flutter-uncertain"):
        assert there(task, "sac", 0)  # what it called its memory is its replay now
        assert there(task, "shac") and not there(task, "shac", share=2.0)
        assert there(task, "lqg", None)
    assert there("track-uncertain", "ppo") and not there("flutter-uncertain", "ppo")


def test_who_remembers_is_in_the_study_where_the_plant_is_hidden(tmp_path):
    options = results.parse(["--tasks", "reach", "payload", "--seeds", "1", "--out", str(tmp_path)])
    made = {run.name for run in results.plan(options)}
    assert {"payload-shac-gru-0", "payload-student-0", "reach-shac-0"} < made
    assert "reach-shac-gru-0" not in made
    for name in tuned.REMEMBERING:
        settings = results.Run("flutter-uncertain", name, 0).settings
        assert settings["memory"] == 64 and settings["frames"] == 0
