"""Answers with errors: what intervals are made of, failed samples, until; coverage itself is
measured by the study of it.
"""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam.uncertainty.estimate import quantile_of_sorted
from torchbeam.uncertainty.samples import Samples
from torchbeam.uncertainty.stream import summarised

LAWS = {"a": (0.0, 1.0), "b": (0.0, 1.0)}


def total(theta):
    return theta.sum(-1)


def test_intervals_of_plain_samples():
    """y = a: Student's interval of the mean; order statistics; Clopper and Pearson."""
    found = tb.monte_carlo(lambda theta: theta[:, 0], LAWS, 400, design="plain")
    mean, low, high = found.mean_interval(0.95)
    assert_close((high - low) / 2, found.y.std() / 20 * 1.96593)  # t of 399
    assert low < mean < high and found.mean_interval().samples == 400
    ordered = found.y.sort().values
    estimate, low, high = found.quantile(0.5, interval=0.9)
    assert low in ordered and high in ordered and low < estimate < high
    at = found.exceedance(0.9, 0.95)
    hits = int((found.y > 0.9).sum())
    assert (
        at.estimate == hits / 400 and 0 < at.low < at.estimate < at.high and "Clopper" in at.method
    )
    assert found.exceedance(2.0).low == 0 and found.exceedance(2.0).high == pytest.approx(
        1 - 0.025 ** (1 / 400)
    )


def test_intervals_of_replicates():
    """Means of 16 replicates of 64, by hand; much shorter than of as many independent samples.
    Deviation and quantiles too.
    """
    found = tb.monte_carlo(total, LAWS, 1024, replicates=16)
    means = found.y.reshape(16, 64).mean(1)
    mean, low, high = found.mean_interval(0.95)
    wanted = tuple(found.y.mean() + k * means.std() / 4 * 2.13145 for k in (-1, 0, 1))  # t of 15
    assert_close((low, mean, high), wanted, rtol=1e-6, atol=0)
    plain = tb.monte_carlo(total, LAWS, 1024, design="plain")
    for statistic in (
        lambda s: s.mean_interval(),
        lambda s: s.quantile(0.9, 0.95),
        lambda s: s.deviation_interval(),
        lambda s: s.exceedance(1.4),
    ):
        a, b = statistic(found), statistic(plain)
        assert a.high - a.low < 0.6 * (b.high - b.low)
        assert "16 replicates" in a.method
    assert abs(found.deviation_interval().estimate - 1 / 6**0.5) < 1e-3


def test_shapes():
    """Of y (n, 3): a level, several, thresholds of several shapes, bands."""
    found = tb.monte_carlo(
        lambda theta: theta[:, :1] * torch.tensor([1.0, 2.0, 3.0]), LAWS, 256, replicates=8
    )
    stream = tb.monte_carlo_stream(
        lambda theta: theta[:, :1] * torch.ones(3), LAWS, 64, replicates=8
    )
    for one in (found, stream):
        with pytest.raises(
            ValueError, match=r"y of a sample with the batch axes \(2,\) and \(3,\) were given"
        ):
            one.exceedance([0.5, 0.7])
    assert found.quantile(0.5, 0.9).low.shape == (3,) and found.quantile(
        (0.1, 0.5), 0.9
    ).low.shape == (2, 3)
    assert found.exceedance(0.5).low.shape == (3,) and found.exceedance(
        [[0.5], [1.5]]
    ).low.shape == (2, 3)
    wanted = torch.tensor([[0.5, 0.75, 5 / 6], [0, 0.25, 0.5]])
    assert_close(found.exceedance([[0.5], [1.5]]).estimate, wanted, rtol=0, atol=6e-3)
    bands = found.bands(0.8)
    assert_close(
        bands.estimate,
        torch.tensor([[0.1], [0.5], [0.9]]) * torch.tensor([1.0, 2.0, 3.0]),
        rtol=0,
        atol=2e-2,
    )
    one = tb.monte_carlo(total, LAWS, 256)
    assert (
        one.exceedance([0.5, 1.0, 1.5]).estimate.shape == (3,)
        and one.quantile(0.5, 0.9).low.ndim == 0
    )
    y = torch.randn(1001, 2)
    levels = torch.tensor([0.0, 0.33, 1.0])
    assert_close(quantile_of_sorted(y.sort(0).values, levels), y.quantile(levels, 0))


def test_few_samples_say_so():
    """A quantile beyond the samples has no upper bound; replicates with too few hits leave the word
    to the binomial law.
    """
    found = tb.monte_carlo(total, LAWS, 64, replicates=8)
    assert (
        found.quantile(0.999, 0.95).high == math.inf and found.quantile(0.5, 0.95).high < math.inf
    )
    rare = found.exceedance(1.9)
    assert "Clopper" in rare.method and rare.high > 0.05
    levels = (0.0, 1e-5, 0.02, 0.5, 0.98, 0.999, 1 - 1e-5, 1.0)
    for n, replicates in ((8, None), (64, None), (64, 4)):  # an estimate is in its own interval
        q = tb.monte_carlo(total, LAWS, n, replicates=replicates).quantile(levels, 0.95)
        assert ((q.low <= q.estimate) & (q.estimate <= q.high)).all()


def test_failures_are_told():
    """By reason in each statistic; the exceedance with them, and without."""

    def function(theta):
        a = theta[:, 0]
        return torch.where(a < 0.1, torch.nan, a), torch.where(a > 0.8, 7, 0)

    found = tb.monte_carlo(function, LAWS, 1000, replicates=8, sentences={7: "buckled"})
    assert found.reasons == {"buckled": 200, "y is not finite": 100}
    own = tb.monte_carlo(lambda theta: (theta[:, 0], theta[:, 0].long() + 3), LAWS, 8).reasons
    assert all(why.startswith(("status 3 (torchbeam's: ", "status 4 (")) for why in own), own
    for statistic in (
        found.mean_interval(),
        found.quantile(0.5, 0.9),
        found.exceedance(0.5),
        found.deviation_interval(),
    ):
        assert (
            statistic.failed == 300
            and statistic.samples == 700
            and "300 failed, 200: buckled" in repr(statistic)
        )
    shares = [
        found.exceedance(0.5, failed_exceed=choice).estimate.item()
        for choice in (None, True, False)
    ]
    assert shares == [
        pytest.approx(3 / 7, abs=2e-3),
        pytest.approx(0.6, abs=2e-3),
        pytest.approx(0.3, abs=2e-3),
    ]
    none = tb.monte_carlo(lambda theta: theta[:, 0] / 0, LAWS, 8)
    for statistic in (none.mean_interval, lambda: none.quantile(0.5), lambda: none.exceedance(1.0)):
        with pytest.raises(ValueError, match="all 8 samples failed"):
            statistic()
    assert none.exceedance(1.0, failed_exceed=True).estimate == 1


def test_until(tmp_path):
    """Replicates until the error is reached: fewer for a larger one; taken up again from its
    folder; of another statistic.
    """
    calls = []

    def counted(theta):
        calls.append(len(theta))
        return theta.square().sum(-1)

    def relative(samples):
        return samples.mean_interval().relative_error.item()

    def error(samples):
        return samples.quantile(0.5, 0.95)

    coarse = tb.monte_carlo(counted, LAWS, 4096, until=1e-2, out=tmp_path)
    # 64 points each: no fewer are looked at
    assert coarse.replicates == 8 and len(coarse) == 512 and relative(coarse) <= 1e-2
    finer = tb.monte_carlo(counted, LAWS, 4096, until=0.6 * relative(coarse), out=tmp_path)
    assert (
        8 < finer.replicates < 64
        and relative(finer) <= 0.6 * relative(coarse)
        and (finer.y[:512] == coarse.y).all()
    )
    assert sum(calls) == len(finer)
    assert len(tb.monte_carlo(counted, LAWS, 4096, until=1e-9)) == 4096
    history = tb.monte_carlo(
        lambda theta: theta[:, :1] * torch.tensor([0.0, 1.0]), LAWS, 4096, until=1e-2
    )
    assert len(history) < 4096  # the first instant is at rest, exactly
    other = tb.monte_carlo(counted, LAWS, 4096, replicates=32, until=(0.02, error))
    assert other.quantile(0.5, 0.95).relative_error <= 0.02 and len(other) % 128 == 0


def test_one_sample_a_replicate():
    """They are independent samples: shares are counted, not summed. One sample in all tells nothing
    of the error.
    """
    y = torch.linspace(0.5, 8.0, 16)
    own = Samples(("x",), y[:, None], y, torch.zeros(16, dtype=torch.long), 16)
    assert (
        own.exceedance(3.0).estimate == 10 / 16
        and own.exceedance(3.0).method == "Clopper and Pearson"
    )
    one = tb.monte_carlo(lambda theta: 5 + theta[:, 0], LAWS, 1)
    assert one.exceedance(3.0).estimate == 1 and one.exceedance(3.0).low.item() == pytest.approx(
        0.025
    )
    stream = tb.monte_carlo_stream(lambda theta: 5 + theta[:, 0], LAWS, 1, replicates=1)
    for mean, low, high in (one.mean_interval(), stream.mean_interval()):
        assert mean == one.y[0] and low == -math.inf and high == math.inf
    assert stream.deviation.isnan()


def test_replicates_with_few_good_samples():
    """Four replicates of four, of which the first has one good sample and the last none: all nine
    count, in Samples and in a Stream alike; the deviation's error comes from those that have one,
    of one replicate from a bootstrap.
    """
    y = torch.tensor([1.0, 0, 0, 0, 2, 3, 5, 4, 6, 2, 3, 9, 0, 0, 0, 0])
    bad = torch.tensor([0, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1])
    own = Samples(("x",), y[:, None], y, bad, 4)
    stream = tb.monte_carlo_stream(
        lambda theta: (y[: len(theta)], bad[: len(theta)]), LAWS, 16, replicates=1, chunk=16
    )
    stream.moments.clear()
    stream.sketches.clear()
    for k, (part, status) in enumerate(zip(y.chunk(4), bad.chunk(4), strict=True)):
        stream.merge(k, summarised({}, (part[:, None], part, status)))
    groups = [y[:1], y[4:8], y[8:12]]
    means = torch.stack([group.mean() for group in groups])
    half = means.std() / 3**0.5 * 4.302653  # t of 2
    for found in (own, stream):
        mean, low, high = found.mean_interval()
        assert mean == pytest.approx(35 / 9) and found.mean_interval().samples == 9
        assert_close(
            torch.stack((low, high)), torch.stack((mean - half, mean + half)), rtol=1e-6, atol=0
        )
        assert found.exceedance(2.5).estimate == pytest.approx(6 / 9) and found.quantile(
            0.5
        ) == pytest.approx(3.0, rel=1e-3)
    spread = own.deviation_interval()
    assert (
        spread.method == "2 replicates"
        and torch.isfinite(spread.low)
        and spread.estimate == own.deviation
    )
    alone = Samples(
        ("x",), y[:, None], y, torch.where(torch.arange(16) < 8, bad, 1), 4
    ).deviation_interval()
    assert (
        alone.method == "bootstrap"
        and alone.samples == 5
        and 0 <= alone.low < alone.estimate < alone.high
    )
    last = Samples(("x",), y[:, None], y, (torch.arange(16) != 5).long(), 4).statistic(
        lambda y: y.mean(0)
    )
    assert (last.estimate, last.low, last.high) == (3.0, -math.inf, math.inf)


def test_two_replicates_tell_little():
    """Of two, Student's factor is 12.7: a bound that would lie beyond all samples is not there."""
    y = torch.cat((torch.linspace(0, 1, 100), torch.linspace(0.5, 1.5, 100)))
    own = Samples(("x",), y[:, None], y, torch.zeros(200, dtype=torch.long), 2)
    _, low, high = own.quantile(0.5, interval=0.95)
    assert low == -math.inf and high == math.inf


def test_sure_successes():
    """A y that is true in all of 256 samples: not surely always."""
    found = tb.monte_carlo(lambda theta: theta[:, 0] > -1, LAWS, 256, replicates=16).mean_interval()
    assert (
        found.estimate == 1 and found.low == pytest.approx(0.025 ** (1 / 256)) and found.high == 1
    )


def test_ranks_of_many():
    """Samples beyond 2^24, which float32 does not count: the last of them is found."""
    y = torch.zeros(2**24 + 4)
    y[-1] = 1.0
    assert quantile_of_sorted(y, torch.tensor([1.0])) == 1.0


def test_bootstrap():
    """Of the deviation of 1000 normal samples: close to its normal theory, deviation/sqrt(2 n)
    times 1.96 on each side.
    """
    found = tb.monte_carlo(
        lambda theta: theta[:, 0], {"x": tb.laws.Normal(0.0, 1.0)}, 1000, design="plain"
    )
    found = found.deviation_interval(0.95)
    assert_close((found.high - found.low) / 2, torch.tensor(1.96 / 2000**0.5), rtol=0.15, atol=0)
    assert found.method == "bootstrap"


def test_successes():
    """A y of yes and no: its mean is a probability, its quantiles are numbers."""
    found = tb.monte_carlo(lambda theta: theta[:, 0] > 0.25, LAWS, 1024, replicates=16)
    mean, low, high = found.mean_interval()
    assert low <= 0.75 <= high and mean == pytest.approx(0.75, abs=2e-3)
    assert (
        found.quantile((0.1, 0.9)).tolist() == [0.0, 1.0] and found.exceedance(0.5).estimate == mean
    )
    assert_close(found.mean, mean, check_dtype=False)
    assert found.deviation.item() == pytest.approx(math.sqrt(0.75 * 0.25), rel=1e-2)


def test_all_failed():
    """No number is made of none."""
    found = tb.monte_carlo(lambda theta: theta[:, 0] / 0, LAWS, 16, replicates=2)
    for ask in (
        lambda: found.mean,
        lambda: found.deviation,
        lambda: found.quantile(0.5),
        found.mean_interval,
        found.summary,
    ):
        with pytest.raises(ValueError, match="all 16 samples failed"):
            ask()


def test_convergence():
    """By hand for the replicates; slopes: n^-1/2 of plain samples, beyond n^-1 of a Sobol sequence,
    for a smooth y.
    """
    found = tb.monte_carlo(total, LAWS, 1024, replicates=16)
    n, error = found.convergence(1.0)
    assert n.tolist() == [1, 2, 4, 8, 16, 32, 64]
    assert_close(error[3], (found.y.reshape(16, 64)[:, :8].mean(1) - 1).square().mean().sqrt())
    assert_close(
        found.convergence()[1][0],
        found.y.reshape(16, 64)[:, 0].sub(found.mean).square().sum().div(15).sqrt(),
    )
    slopes = []
    for design in ("sobol", "plain"):
        n, error = tb.monte_carlo(total, LAWS, 2**14, design=design, replicates=16).convergence(1.0)
        x, y = n.log() - n.log().mean(), error.log()
        slopes.append(((x * y).sum() / x.square().sum()).item())
    assert slopes[0] < -1.0 and -0.65 < slopes[1] < -0.35
    with pytest.raises(ValueError, match="of one Sobol sequence was asked for"):
        tb.monte_carlo(total, LAWS, 8).convergence()


def test_progress(capsys):
    """A function gets counts after each chunk; the terminal a line."""
    seen = []
    tb.monte_carlo(
        lambda theta: theta / 0, LAWS, 100, chunk=30,
        progress=lambda at: seen.append((at.done, at.failed, at.eta)),
    )  # fmt: skip
    assert [x[:2] for x in seen] == [(30, 30), (60, 60), (90, 90), (100, 100)] and seen[-1][2] == 0
    tb.monte_carlo(total, LAWS, 100, progress=True)
    assert "100 of 100 samples, 100 %" in capsys.readouterr().err


def test_chunk_from_throughput(tmp_path):
    """A power of two; a folder keeps its own."""
    sizes = []

    def slow(theta):
        sizes.append(len(theta))
        return total(theta)

    found = tb.monte_carlo(slow, LAWS, 4096, chunk="auto", out=tmp_path)
    chunk = max(sizes)
    assert len(found) == 4096 and chunk & (chunk - 1) == 0 and chunk >= 32
    sizes.clear()
    tb.monte_carlo(slow, LAWS, 8192, chunk="auto", out=tmp_path)
    assert sum(sizes) == 4096


# fmt: off
REFUSED = {
    "level": (lambda s: s.mean_interval(1.5), "level = 1.5 was given; a probability between"),
    "levels": (lambda s: s.quantile(2.0), "levels = 2.0 were given; probabilities"),
    "interval": (lambda s: s.quantile(0.5, interval=0.0), "interval = 0 was given"),
    "threshold": (lambda s: s.exceedance(math.nan), "x holds nan"),
    "until": (lambda s: tb.monte_carlo(total, LAWS, 256, until=2.0),
              "until = 2.0 was given; a relative error"),
    "until of a number": (lambda s: tb.monte_carlo(total, LAWS, 256, until=(0.1, lambda s: s.mean)),
                          "gave a Tensor was given"),
    "until with few": (lambda s: tb.monte_carlo(total, LAWS, 4, until=0.1),
                       "for 4 replicates; at least 8"),
    "progress": (lambda s: tb.monte_carlo(total, LAWS, 4, progress=3),
                 "progress = 3 was given; a function of progress"),
    "chunk": (lambda s: tb.monte_carlo(total, LAWS, 4, chunk="big"), "chunk = 'big' was given"),
    "statistic": (lambda s: s.statistic(3), "function = 3 was given; a function"),
    "statistic that is no tensor": (lambda s: s.statistic(len),
                                    "a statistic that gave a int was given; a tensor"),
    "statistic of several shapes": (lambda s: s.statistic(lambda y: y.unique()),
                                    r"gave \(8,\) of all samples and \(\d,\) of"),
    "failed that exceed": (lambda s: s.exceedance(0.5, failed_exceed=3),
                           "failed_exceed = 3 was given; True or False"),
    "reference": (lambda s: s.convergence([1.0, 2.0]), r"a reference \(2,\) was given"),
    "levels of a summary": (lambda s: s.summary(levels=0.5),
                            "levels = 0.5 were given; a sequence of numbers"),
    "thresholds of a summary": (lambda s: s.summary(thresholds="ab"),
                                "thresholds = 'ab' were given"),
    "path of a summary": (lambda s: s.write_summary(3), "path = 3 was given; a path"),
}
# fmt: on


@refusals(REFUSED)
def test_refused(call):
    call(tb.monte_carlo(total, LAWS, 8, design="plain"))


def test_an_estimate_of_several_numbers_shows_and_indexes_them():
    """Numbers by number, as its three tensors are; the text has the first six."""
    whole = tb.monte_carlo(
        lambda theta: theta * torch.arange(1.0, 9.0), {"a": (0.0, 1.0)}, 64
    ).quantile(0.5, interval=0.95)
    assert (
        whole.estimate.shape == (8,)
        and repr(whole).count(" to ") == 6
        and "; ...; " not in repr(whole[:6])
    )
    one = whole[2]
    assert repr(one).startswith(
        f"Estimate({whole.estimate[2]:.5g}, {whole.low[2]:.5g} to {whole.high[2]:.5g} at 95 %"
    )
    assert torch.equal(whole[..., 1:3].high, whole.high[1:3]) and one.samples == whole.samples
    for index in (slice(3), 0, "a"):
        with pytest.raises(IndexError, match="was asked for; it is a single number"):
            one[index]
    with pytest.raises(IndexError, match=r"Estimate\[8\] was asked for; its numbers .* \(8,\)"):
        whole[8]
