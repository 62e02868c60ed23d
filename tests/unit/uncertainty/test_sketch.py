"""Sketch: quantiles to the error it states, for any order and any parts; counts above."""

import math

import pytest
import torch
from torch.testing import assert_close

from torchbeam.uncertainty.moments import Moments
from torchbeam.uncertainty.sketch import Sketch

DRAW = torch.Generator().manual_seed(0)
SETS = {
    "lognormal": torch.randn(20000, generator=DRAW).exp(),
    "of both signs": torch.randn(20000, generator=DRAW),
    "with zeros": torch.randn(20000, generator=DRAW) * (torch.rand(20000, generator=DRAW) > 0.3),
    "over 600 decades": 10 ** (600 * torch.rand(20000, generator=DRAW) - 300),
    "nearly one number": 1 + 1e-7 * torch.rand(20000, generator=DRAW),
    "whole numbers": torch.randint(-5, 6, (20000,), generator=DRAW).double(),
}


def sketch(x, most=500):
    found = Sketch.empty(most)
    found.add(x)
    return found


@pytest.mark.parametrize("name", SETS)
def test_quantiles(name):
    """Each order statistic to the stated error, in at most 500 bins; counts are all there."""
    x = SETS[name]
    found = sketch(x)
    ranks = torch.tensor([0, 1, 137, 5000, 10000, 19998, 19999])
    wanted = x.sort().values[ranks]
    assert (
        (found.at_ranks(ranks) - wanted).abs() <= found.error * wanted.abs() * (1 + 1e-9) + 1e-300
    ).all()
    assert len(found.keys) <= 500 and found.total == 20000 and (found.keys.diff() > 0).all()
    assert found.error < 1e-2 or name in ("over 600 decades", "of both signs", "with zeros")


def test_between_whole_ranks():
    """The median of 1 and 3 is 2."""
    found = sketch(torch.tensor([3.0, 1.0])).at_ranks(torch.tensor([0.0, 0.5, 1.0]))
    assert found.tolist() == pytest.approx([1, 2, 3], rel=1e-8)


@pytest.mark.parametrize("name", SETS)
def test_above(name):
    """Between the counts that a threshold's bin leaves open, which are few."""
    x, found = SETS[name], sketch(SETS[name])
    for at in (
        *x[:20],
        torch.tensor(0.0),
        torch.tensor(math.pi),
        torch.tensor(-1e9),
        torch.tensor(1e200),
    ):
        least, most = found.above(at)
        assert least <= (x > at).sum() <= most
    if name == "whole numbers":  # each alone in its bin
        for at in range(-6, 7):
            assert found.above(torch.tensor(at)) == ((x > at).sum(), (x > at).sum())


def test_order_and_parts_do_not_matter():
    """Backwards, in parts of 7, merged in any order: the same counts in the same bins."""
    for x in SETS.values():
        whole, back = sketch(x), sketch(x.flip(0))
        parts = [sketch(part, 500) for part in x.split(1999)]
        merged = Sketch.empty(500)
        for part in reversed(parts):
            merged.merge(part)
        for other in (back, merged):
            for field in ("keys", "counts", "least", "largest"):
                assert (getattr(other, field) == getattr(whole, field)).all()
            assert other.joined == whole.joined


def test_moments():
    """Parts merged: as of the whole, far from zero too."""
    x = 1e6 + torch.randn(5000, 2, generator=DRAW).exp()
    merged = Moments.of(x[:1])
    for part in (x[1:3], x[3:1700], x[1700:]):
        merged = merged.merged(Moments.of(part))
    d = x - x.mean(0)
    assert_close(merged.mean, x.mean(0), rtol=1e-14, atol=0)
    assert_close(merged.deviation, x.std(0), rtol=1e-9, atol=0)
    assert_close(merged.skewness, (d**3).mean(0) / (d**2).mean(0) ** 1.5, rtol=1e-8, atol=0)
    assert_close(merged.kurtosis, (d**4).mean(0) / (d**2).mean(0) ** 2, rtol=1e-8, atol=0)
    assert (
        (merged.least == x.amin(0)).all()
        and (merged.largest == x.amax(0)).all()
        and merged.n == 5000
    )
