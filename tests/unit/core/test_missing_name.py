"""Names that engineers type and that a module calls otherwise."""

import pytest
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
        (tb, "lqr", "torchbeam_envs.baselines is near"),
        (tb.plot, "show", "save is near"),
        (tb.sensors, "Accelerometer", "NodeAcceleration is near"),
        (tb.laws, "Lognormal", "LogNormal, Normal are near"),
    ],
)
def test_the_sentence_says_what_is_near(owner, name, near):
    with pytest.raises(AttributeError, match=f"no attribute {name!r}; {near}"):
        getattr(owner, name)


@pytest.mark.parametrize("name", ["__wrapped__", "qqqq"])
def test_nothing_near(name):
    assert not hasattr(tb, name)
    with pytest.raises(AttributeError, match=f"no attribute {name!r}$"):
        getattr(tb, name)
