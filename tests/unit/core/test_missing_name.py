"""Names that engineers type and that a module calls otherwise."""

from operator import attrgetter

import pytest
import torch
import torchbeam_envs.baselines

import torchbeam as tb
from torchbeam.core.missing_name import ELSEWHERE


def test_what_is_offered_is_there():
    """And no word stands for what has that name itself."""
    for word, name in ELSEWHERE.items():
        envs = name.removeprefix("torchbeam_envs")
        assert envs in ("", ".baselines") if envs != name else name in tb.__all__, name
        assert word not in tb.__all__, word
    assert torchbeam_envs.baselines.LQR
    for module in (tb.plot, tb.sensors, tb.laws):
        for word, name in module.ELSEWHERE.items():
            assert name in module.__all__ and word not in map(str.lower, module.__all__), word


@pytest.mark.parametrize(
    ("owner", "name", "near"),
    [
        (tb, "Clamp", "Support is near"),
        (tb, "DistributedLoads", "LineLoad is near"),
        (tb, "buckling_load", "critical_load is near"),
        (tb, "Hnge", "Hinge is near"),
        (tb, "Gripper", "Support is near"),
        (tb, "Torus", "Contact is near"),
        (tb, "lqr", "torchbeam_envs.baselines is near"),
        (tb.plot, "show", "save is near"),
        (tb.sensors, "Accelerometer", "NodeAcceleration is near"),
        (tb.laws, "Lognormal", "LogNormal, Normal are near"),
    ],
)
def test_the_sentence_says_what_is_near(owner, name, near):
    with pytest.raises(AttributeError, match=f"no attribute {name!r}; {near}"):
        getattr(owner, name)


FORCE = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)


def linear():
    beam = tb.Beam.straight(1.0, 1, tb.Section.circle(0.01, 210e9, 0.3, 7800.0))
    return tb.linearize(tb.Scene(beam, tb.TipLoad(force=tb.Input("u", 3))), inputs={"u": (0, 0, 0)})


def fit():
    return tb.identify(lambda p: p["k"][..., None] * FORCE, 2.0 * FORCE + 0.1, {"k": 1.0})


def samples():
    return tb.monte_carlo(lambda x: x[:, 0], {"k": tb.laws.Normal(1.0, 0.1)}, 8)


def solution():
    beam = tb.Beam.straight(1.0, 1, tb.Section.circle(0.01, 210e9, 0.3, 7800.0))
    return tb.simulate(tb.Scene(beam), [0.0, 0.1], step=0.1, engine="eager")


@pytest.mark.parametrize(
    ("result", "name", "near"),
    [
        (solution, "position", "nodes is near"),
        (solution, "reaction_of", "state.reaction_of is near"),
        (linear, "eigenvalues", "poles is near"),
        (linear, "frequency_response", "response is near"),
        (linear, "lqr", "torchbeam_envs.baselines is near"),
        (samples, "std", "deviation is near"),
        (samples, "quantiles", "quantile is near"),
        (fit, "residuals", "readings, of each measurement's data and y, is near"),
        (fit, "stderr", "deviation is near"),
        (fit, "histories", "history is near"),
    ],
)
def test_results_say_what_is_near(result, name, near):
    had = result()
    assert not hasattr(had, "__array__")
    with pytest.raises(AttributeError, match=f"^{type(had).__name__!r} object has .*; {near}$"):
        getattr(had, name)
    for offered in set(had._elsewhere.values()):  # of what it has itself, or torch and the envs
        first = offered.split(",")[0]
        assert "torch" in first or attrgetter(first)(had) is not offered, first
    assert not {word for word in had._elsewhere if hasattr(had, word)}


@pytest.mark.parametrize("name", ["__wrapped__", "qqqq"])
def test_nothing_near(name):
    assert not hasattr(tb, name)
    with pytest.raises(AttributeError, match=f"no attribute {name!r}$"):
        getattr(tb, name)
