"""Laws as a user gives them: from text."""

import pytest

import torchbeam as tb
from torchbeam.uncertainty.given_law import KINDS, of_text


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
