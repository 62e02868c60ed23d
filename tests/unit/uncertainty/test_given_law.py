"""Laws as a user gives them: from text, and of SciPy."""

import pytest
import torch
from scipy import stats
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.uncertainty.given_law import KINDS, of_text
from torchbeam.uncertainty.law_scores import of_score, score

NEWER = hasattr(stats, "Normal")


def test_from_text():
    """What a file may say."""
    assert of_text("EI", {"law": "normal", "mean": 1, "deviation": 0.1}) == tb.laws.Normal(1.0, 0.1)
    assert of_text(
        "EI", {"law": "truncated", "of": {"law": "Gumbel", "location": 1, "scale": 1}, "least": 0}
    ) == (tb.laws.Truncated(tb.laws.Gumbel(1.0, 1.0), 0.0))
    assert (
        of_text("EI", [0, 1]) == [0, 1]
        and of_text("EI", 2) == tb.laws.Constant(2.0)
        and set(KINDS) > {"empirical"}
    )
    for given, sentence in (
        ({"law": "cauchy"}, "one of constant, uniform"),
        ({"law": "normal", "mean": 1}, "Normal has mean, deviation"),
        ({"law": "normal", "mean": 1, "sd": 1}, "'sd' was given for the law of 'EI'; Normal has"),
    ):
        with pytest.raises(ValueError, match=sentence):
            of_text("EI", given)


@pytest.mark.parametrize(
    "law",
    [
        stats.norm(2.0, 0.5),
        pytest.param(
            stats.Normal(mu=2.0, sigma=0.5) if NEWER else None,
            marks=pytest.mark.skipif(not NEWER, reason="SciPy 1.15 and later have these"),
        ),
    ],
)
def test_scipys_laws_have_both_tails(law):
    """As torchbeam's own normal law, to ten deviations, also under a copula and truncated; their
    mean between 1 and 9 is SciPy's.
    """
    z = torch.linspace(-10, 10, 41, dtype=torch.float64)
    assert_close(of_score(law, z), 2 + 0.5 * z, rtol=1e-12, atol=1e-12)
    assert_close(score(law, 2 + 0.5 * z), z, rtol=1e-9, atol=1e-12)
    options = dict(by_name=True, correlation={("a", "b"): 0.5})
    ours, theirs = (
        tb.monte_carlo(lambda a, b: a * b, {"a": one, "b": (0.0, 1.0)}, 64, **options).y
        for one in (tb.laws.Normal(2.0, 0.5), law)
    )
    assert_close(ours, theirs, rtol=1e-12, atol=0)
    gamma = stats.gamma(2.0, scale=3.0)
    between = tb.laws.Truncated(gamma, 1.0, 9.0)
    mean = tb.monte_carlo(lambda a: a, {"a": between}, 4096, by_name=True).mean
    # a scrambled sequence's error: about 1/n of the range
    assert_close(float(mean), gamma.expect(lb=1.0, ub=9.0, conditional=True), rtol=1e-3, atol=0)


@pytest.mark.parametrize(
    "law, why",
    [
        (stats.norm(torch.linspace(0, 1, 64).numpy(), 1.0), r"which has \(64,\) numbers, not one"),
        (stats.gamma, "which has parameters that are not given"),
    ]
    + [
        (stats.Normal(mu=numbers, sigma=1.0), r"which has \(64,\) numbers, not one")
        for numbers in [torch.linspace(0, 1, 64).numpy()] * NEWER
    ],
)
def test_a_law_of_scipy_that_is_not_of_one_number_is_refused(law, why):
    """Also where it has as many numbers as there are samples: each would have a law of its own."""
    with pytest.raises(ValueError, match=why):
        tb.monte_carlo(lambda a: a, {"a": law}, 64, by_name=True)
    with pytest.raises(ValueError, match=why):
        tb.laws.Truncated(law, 0.1, 0.9)
