"""Wrappers that are known to work: each is what `docs` may promise. And the command that measures
the envs.
"""

import csv
import itertools
import json
import time

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import wrappers as single
from gymnasium.wrappers import vector as many
from torchbeam_envs import benchmark, mpc_times, reset_times

import torchbeam as tb

ID = "torchbeam/TipReachPlanar-v1"
SMALL = dict(elements=2, substeps=1, max_episode_steps=4)
MODES = ["NextStep", "SameStep"]


def make_vec(n=3, **changes):
    return gymnasium.make_vec(ID, num_envs=n, **{**SMALL, **changes})


def run(env, steps=10):
    """Random actions across the ends of two episodes: the last results."""
    env.action_space.seed(0)
    env.reset(seed=0)
    for _ in range(steps):
        results = env.step(env.action_space.sample())
    return results


@pytest.mark.parametrize(
    "wrapper",
    [
        lambda env: single.TimeLimit(env, 3),
        single.RecordEpisodeStatistics,
        single.NormalizeObservation,
        single.NormalizeReward,
        single.ClipAction,
        lambda env: single.RescaleAction(env, -2.0, 2.0),
        single.FlattenObservation,
        single.TimeAwareObservation,
        lambda env: single.FrameStackObservation(env, 3),
        lambda env: single.TransformReward(env, lambda r: r / 10),
        single.Autoreset,
        lambda env: single.DelayObservation(env, 1),
    ],
)
def test_single(wrapper):
    env = wrapper(gymnasium.make(ID, **SMALL))
    observation, reward, *_ = run(env, 3)
    assert np.isfinite(np.asarray(observation)).all() and np.isfinite(reward)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    "wrapper",
    [
        many.RecordEpisodeStatistics,
        many.NormalizeReward,
        many.ClipAction,
        lambda env: many.ClipReward(env, -1.0, 0.0),
        lambda env: many.RescaleAction(env, -2.0, 2.0),
        lambda env: many.TransformReward(env, lambda r: r / 10),
        many.DictInfoToList,
    ],
)
def test_vector(wrapper, mode):
    env = make_vec(autoreset_mode=mode, randomize=True)
    observation, reward, *_ = run(wrapper(env))
    assert np.isfinite(np.asarray(observation)).all() and np.isfinite(np.asarray(reward)).all()


@pytest.mark.parametrize(
    "wrapper",
    [
        many.NormalizeObservation,
        many.FlattenObservation,
        lambda env: many.RescaleObservation(env, -1.0, 1.0),
    ],
)
def test_vector_observations(wrapper):
    """Gymnasium's observation wrappers do not take SameStep; by NextStep they work, and a failure
    leaves no NaN in them.
    """
    env = wrapper(make_vec(randomize={"stiffness": (0.9, 1.1)}))
    assert np.isfinite(run(env)[0]).all()
    env.reset(options={"params": {"stiffness": [1.0, 1.0, 1e-30]}})
    assert np.isfinite(env.step(np.zeros(env.action_space.shape))[0]).all()


def test_episode_statistics():
    """Return and length of four-step episodes, summed here."""
    env = many.RecordEpisodeStatistics(make_vec(autoreset_mode="SameStep"))
    env.reset(seed=0)
    total = np.zeros(3)
    for _ in range(4):
        _, reward, *_, info = env.step(np.full((3, 1), 0.3))
        total += reward
    np.testing.assert_allclose(info["episode"]["r"], total)
    assert info["episode"]["l"].tolist() == [4, 4, 4]


def test_dense_final_observations_as_tensors():
    """NumpyToTorch takes `final_obs` because it is one array, not an array of objects."""
    pytest.importorskip("array_api_compat")
    env = many.NumpyToTorch(make_vec(autoreset_mode="SameStep"))
    *_, truncated, info = run(env, 4)
    assert (
        truncated.all()
        and isinstance(info["final_obs"], torch.Tensor)
        and info["final_obs"].shape == (3, 11)
    )


def test_sync_and_gymnasium_vector_envs():
    """The single env inside Gymnasium's own vector env does what the vector env does."""
    own = make_vec(vectorization_mode="vector_entry_point")
    sync = gymnasium.make_vec(ID, num_envs=3, vectorization_mode="sync", **SMALL)
    np.testing.assert_allclose(own.reset(seed=0)[0], sync.reset(seed=0)[0], atol=1e-6)
    for _ in range(6):
        action = own.action_space.sample()
        a, b = own.step(action), sync.step(action)
        np.testing.assert_allclose(a[0], b[0], atol=1e-6)
        np.testing.assert_allclose(a[1], b[1], atol=1e-6)
        np.testing.assert_array_equal(a[3], b[3])


def test_error_of_the_mesh(monkeypatch):
    """Two elements in a plane, in steps of 20 ms, against sixteen in steps of 2.5 ms, for four
    intervals; none of a strip that is lost at once.
    """
    assert 1e-3 < benchmark.error(ID, **SMALL) < 0.5
    monkeypatch.setattr(benchmark, "FINER", {})
    lost = benchmark.error(
        "torchbeam/FlutterHoldPlanar-v1", elements=2, kick=30.0, max_episode_steps=3, engine="eager"
    )
    assert (
        lost is None
        and "%"
        not in benchmark.markdown([benchmark.Throughput(ID, 1, 1.0, 1.0, 0.1, None)]).split("|")[-2]
    )


def test_overhead_is_beside_the_simulation_as_it_is_made(monkeypatch):
    """By the call that makes all substeps of an interval at once, which the env steps by."""
    made, repeat = [], tb.Stepper.repeat
    monkeypatch.setattr(
        tb.Stepper, "repeat", lambda self, *args: made.append(1) or repeat(self, *args)
    )
    assert benchmark.overhead(ID, 2, **{**SMALL, "max_episode_steps": 50}) > 0
    assert len(made) == benchmark.STEPS + 2


def test_the_command_that_measures(tmp_path, capsys, monkeypatch):
    """Two rows in all three files."""
    pytest.importorskip("gymnasium", minversion="1.4")  # benchmark_vector_step
    # tested above; slow on the mesh it compares with
    monkeypatch.setattr(benchmark, "error", lambda id, **arguments: 0.01)
    rows = benchmark.measure(ID, [2], 0.1, **SMALL)
    assert len(rows) == 1 and rows[0].rate > 1 and rows[0].overhead > 0
    assert (
        benchmark.main(
            ["--task", "TipReach", "--batches", "1", "--seconds", "0.05", "--out", str(tmp_path)]
        )
        == 0
    )
    written = json.loads((tmp_path / "envs.json").read_text())
    assert [row["id"] for row in written["rows"]] == ["torchbeam/TipReach-v1", ID]
    assert (tmp_path / "envs.md").read_text().strip() in capsys.readouterr().out
    assert len((tmp_path / "envs.csv").read_text().splitlines()) == 3


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--task", "TipReachBlockRate"], "invalid choice"),
        (["--batches", "4", "0"], "--batches 0 was given"),
        (["--seconds", "0"], "--seconds 0 was given"),
        (["--threads", "0"], "--threads 0 was given"),
    ],
)
def test_the_command_refuses_first(given, said, capsys):
    with pytest.raises(SystemExit):
        benchmark.main(given)
    assert said in capsys.readouterr().err


def test_rows_for_the_benchmark_of_the_engine(monkeypatch):
    """One env in space, a batch in the plane, by the entry point that `python -m studies bench`
    asks; by clocks that go on by 10 ms each time they are read.
    """
    for name in ("perf_counter", "process_time"):
        clock = itertools.count()
        monkeypatch.setattr(time, name, lambda clock=clock: 1e-2 * next(clock))
    monkeypatch.setattr(benchmark, "STEPS", 2)
    monkeypatch.setattr(benchmark, "overhead", lambda id, batch: 0.1)
    rows = list(benchmark.rows(quick=True))
    assert [(row.what.split(":")[0], row.batch) for row in rows[::2]] == [
        ("torchbeam/TipReach-v1", 1),
        ("torchbeam/TipReachPlanar-v1", 64),
    ]
    assert all(row.part == "environments" and row.best >= row.median > 0 for row in rows)
    assert rows[2].best == pytest.approx(64 * rows[0].best)


def test_times_of_predictive_control(tmp_path, monkeypatch, capsys):
    """Of an episode, but for its first intervals; the command writes what was measured."""
    row = mpc_times.measure(benchmark.IDS["TipReachPlanar"], 1, 1, elements=2, horizon=3)
    assert row.intervals == 50 - mpc_times.FIRST and row.interval == 0.02 and row.actions == 1
    assert 0 < row.median <= row.most and 0 < row.processor
    monkeypatch.setattr(mpc_times, "rows", lambda ids, episodes: [row] * len(ids) * episodes)
    assert benchmark.main(["--mpc", "2", "--out", str(tmp_path)]) == 0
    written = json.loads((tmp_path / "mpc.json").read_text())
    assert len(written["rows"]) == 2 * len(mpc_times.TASKS) and written["horizon"] == 25
    assert f"| {1e3 * row.median:.3g} |" in (tmp_path / "mpc.md").read_text()
    columns = next(csv.DictReader(open(tmp_path / "mpc.csv")))
    assert float(columns["median, s"]) == row.median and float(columns["interval, s"]) == 0.02
    with pytest.raises(SystemExit):
        benchmark.main(["--mpc", "0"])
    assert "--mpc 0 was given" in capsys.readouterr().err


def test_times_of_resets(tmp_path, monkeypatch, capsys):
    """Resets of uncertain plants cost more than nothing; the command writes what was measured."""
    row = reset_times.measure(benchmark.IDS["SlewPlanar"], 2, 2, elements=2, substeps=1)
    assert row.step > 0 and row.reset > 0 and row.few > 0 and row.batch == 2
    monkeypatch.setattr(
        reset_times, "measure", lambda id, *given: row._replace(id=id, adapter=None)
    )
    assert benchmark.main(["--resets", "2", "--out", str(tmp_path)]) == 0
    written = json.loads((tmp_path / "resets.json").read_text())
    assert len(written["rows"]) == 10 * len(reset_times.BATCHES) and written["share"] == 8
    same = ", ".join([f"{row.reset / row.step:.2f}"] * len(reset_times.BATCHES))
    assert f"| {same} |" in (tmp_path / "resets.md").read_text()
    columns = next(csv.DictReader(open(tmp_path / "resets.csv")))
    assert float(columns["step, s"]) == row.step and float(columns["reset of all, s"]) == row.reset
    with pytest.raises(SystemExit):
        benchmark.main(["--resets", "0"])
    assert "--resets 0 was given" in capsys.readouterr().err
