"""Few numbers are computed on one thread, whatever torch has; native code and large batches are
divided all the same.
"""

import pytest
import torch
import torchbeam_envs as envs

import torchbeam as tb
from torchbeam.core import one_thread
from torchbeam.core.openmp import openmp
from torchbeam.engine.compiler import team

STRIP = tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-3)


@pytest.fixture
def two_threads():
    """Of this thread of Python alone: torch.set_num_threads would tell MKL for good."""
    library, before = openmp(), torch.get_num_threads()
    if library is None:
        pytest.skip("torch without OpenMP")
    library.omp_set_num_threads(2)
    yield
    assert torch.get_num_threads() == 2
    library.omp_set_num_threads(before)


def scene(seen):
    def force(t):
        seen.append((torch.get_num_threads(), one_thread.threads()))
        return torch.zeros(3) + 0 * t

    beam = tb.Beam.straight(1.0, 2, STRIP)
    return tb.Scene(beam, [tb.TipLoad(force=force), tb.PointLoad(1, force=tb.Input("u", 3))])


def filtered(of):
    model = tb.linearize(of, inputs={"u": (0.0, 0, 0)}).reduced(2)
    options = dict(dt=0.01, noise=1e-3, process={"u": 0.1})
    run = tb.KalmanFilter(of, [tb.sensors.TipPosition()], model=model, **options)
    run(run.start(), (1.0, 0, 0))


CALLS = {
    "equilibrium": lambda of: tb.equilibrium(of, inputs={"u": (0.0, 0, 0)}),
    "simulate": lambda of: tb.simulate(of, [0.0, 0.02], step=0.01, inputs={"u": (0.0, 0, 0)}),
    "Stepper": lambda of: tb.Stepper(of, 0.01)(tb.rest(of), u=(0.0, 0, 0)),
    "rollout": lambda of: tb.rollout(tb.Stepper(of, 0.01), tb.rest(of), 2, u=(0.0, 0, 0)),
    "modes": lambda of: tb.modes(of, count=1, inputs={"u": (0.0, 0, 0)}),
    "linearize": lambda of: tb.linearize(of, inputs={"u": (0.0, 0, 0)}),
    "KalmanFilter": filtered,
}


@pytest.mark.parametrize("name", CALLS)
def test_a_call_of_few_numbers_takes_one_thread(name, two_threads):
    """As a user's function sees it from inside; native code has both."""
    seen = []
    CALLS[name](scene(seen))
    assert seen and set(seen) == {(1, 2)}


def test_a_call_of_many_numbers_takes_all(two_threads, monkeypatch):
    monkeypatch.setattr(one_thread, "FEW", 6 * 3 * 4)  # moves, nodes, samples
    seen = []
    of = scene(seen)
    step = tb.Stepper(of, 0.01)
    step(tb.rest(of, (4,)), u=(0.0, 0, 0))
    assert seen[-1] == (1, 2)
    step(tb.rest(of, (5,)), u=(0.0, 0, 0))
    assert seen[-1] == (2, 2)
    assert one_thread.dense_numbers_of(None) == one_thread.numbers_of("no scene") == 0


def test_an_environment_takes_one_thread(two_threads, monkeypatch):
    env, seen = envs.TipReachVectorEnv(2, elements=2, planar=True), []
    advance = type(env.simulation).advance
    spied = lambda *args: seen.append(torch.get_num_threads()) or advance(*args)  # noqa: E731
    monkeypatch.setattr(type(env.simulation), "advance", spied)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    assert seen == [1]


def test_native_code_is_divided_within(two_threads):
    """A team of two, though torch's own operations have one thread."""
    if team.team_of(team.PROCESS) is None:
        pytest.skip("no team")
    strip = tb.Beam.straight(1.0, 4, STRIP)
    push = torch.zeros(64, 3)
    push[:, 2] = torch.linspace(0, 1, 64)
    of = tb.Scene(strip, [tb.TipLoad(force=push)], plane="xz")
    t = torch.linspace(0, 0.4, 41)
    within = tb.simulate(of, t, step=0.01, engine="compiled").tip.position
    openmp().omp_set_num_threads(1)
    alone = tb.simulate(of, t, step=0.01, engine="compiled").tip.position
    openmp().omp_set_num_threads(2)
    assert torch.equal(within, alone)
