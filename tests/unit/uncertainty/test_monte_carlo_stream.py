"""Streams: what the samples say, without them; taken up again, damaged, killed; constant memory."""

import errno
import math
import os
import signal
import subprocess
import sys

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.core import files
from torchbeam.uncertainty import monte_carlo_stream as module
from torchbeam.uncertainty.sketch import Sketch

LAWS = {"a": (0.0, 1.0), "x": tb.laws.Normal(0.0, 1.0)}


def function(theta):
    y = torch.stack((theta[:, 0] + theta[:, 1], theta[:, 1].exp()), -1)
    return y, torch.where(theta[:, 0] > 0.9, 7, 0)


@pytest.fixture(scope="module", params=["sobol", "plain"])
def both(request):
    options = dict(replicates=16, design=request.param, sentences={7: "buckled"})
    return tb.monte_carlo(function, LAWS, 2**14, **options), tb.monte_carlo_stream(
        function, LAWS, 2**14, chunk=300, **options
    )


def test_moments(both):
    kept, stream = both
    assert_close(stream.mean, kept.mean, rtol=1e-12, atol=0)
    assert_close(stream.deviation, kept.deviation, rtol=1e-12, atol=0)
    d = kept.good - kept.mean
    assert_close(stream.skewness, (d**3).mean(0) / (d**2).mean(0) ** 1.5)
    assert_close(stream.kurtosis, (d**4).mean(0) / (d**2).mean(0) ** 2)
    for a, b in zip(stream.mean_interval(), kept.mean_interval(), strict=True):
        assert_close(a, b, rtol=1e-9, atol=0)


def test_quantiles_and_probabilities(both):
    """To the sketch's error; intervals about as long, and a little longer."""
    kept, stream = both
    levels = (0.01, 0.5, 0.99)
    assert stream.error < 5e-3
    assert_close(stream.quantile(levels), kept.quantile(levels), rtol=2 * stream.error, atol=1e-3)
    a, b = stream.quantile(levels, 0.95), kept.quantile(levels, 0.95)
    assert ((a.high - a.low) < 1.3 * (b.high - b.low) + 4 * stream.error * b.estimate.abs()).all()
    assert (
        (a.low - b.low).abs() <= 4 * stream.error * b.low.abs() + 2e-3
    ).all() and a.reasons == kept.reasons
    x = torch.tensor([1.0, 2.0])
    a, b = stream.exceedance(x), kept.exceedance(x)
    assert_close(a.estimate, b.estimate, rtol=0, atol=2e-3)
    assert ((a.high - a.low) < 1.3 * (b.high - b.low) + 4e-3).all()
    assert (a.low <= b.estimate).all() and (b.estimate <= a.high).all()
    assert stream.exceedance([[1.0], [2.0]]).low.shape == (2, 2) and stream.quantile(0.5).shape == (
        2,
    )
    edges = torch.linspace(-6, 60, 12)
    wanted = torch.stack([torch.histc(y, 11, -6, 60) for y in kept.good.unbind(-1)]) / len(
        kept.good
    )
    assert_close(stream.histogram(edges), wanted, rtol=0, atol=2e-3)
    assert "buckled" in repr(stream) and stream.failed == kept.failed


def test_shares_at_the_least_and_the_largest_value():
    """y = u between 0.3 and 0.6, which three and four samples of ten hold to: all of them lie
    between these edges, and none beyond; of a y of one value alike.
    """

    def held(theta):
        return theta[:, 0].clamp(0.3, 0.6)

    stream = tb.monte_carlo_stream(held, {"u": (0.0, 1.0)}, 4096)
    share = stream.histogram((stream.all.least.item(), 0.4, 0.5, stream.all.largest.item()))
    assert_close(share, torch.tensor([0.4, 0.1, 0.5]), rtol=0, atol=2e-3)
    assert_close(share.sum(), torch.tensor(1.0), rtol=0, atol=1e-12)
    beyond = stream.exceedance(stream.all.largest)
    below = stream.exceedance(stream.all.least - 1e-12)
    assert beyond.estimate == 0 and beyond.high < 2e-3 and below.estimate == 1 and below.low > 0.998
    still = tb.monte_carlo_stream(lambda theta: 0 * theta[:, 0] + 2, {"u": (0.0, 1.0)}, 64)
    assert_close(still.histogram((1.5, 2.0, 2.5)), torch.tensor([0.0, 1.0]), rtol=0, atol=0)


def test_probability_beyond_one_of_a_few_values():
    """y of -2, -1, 0, 1 and 2 alike: P(y > x) is without the samples that are x, as `Samples` has
    it.
    """

    def whole(theta):
        return (theta[:, 0] * 5).floor() - 2

    kept, stream = (
        run(whole, {"u": (0.0, 1.0)}, 1024, replicates=16)
        for run in (tb.monte_carlo, tb.monte_carlo_stream)
    )
    for x in (-3.0, -2.0, -1.0, 0.0, 1.0, 1.5, 2.0):
        assert stream.exceedance(x).estimate == kept.exceedance(x).estimate
    assert stream.quantile((0.1, 0.3, 0.9)).tolist() == [-2.0, -1.0, 2.0]


def test_sketches_are_read_once(both, monkeypatch):
    """An interval of three quantiles of two numbers: two times per number for those of all, once
    for each of 16 replicates.
    """
    read, at_ranks, above = [], Sketch.at_ranks, Sketch.above
    monkeypatch.setattr(
        Sketch, "at_ranks", lambda self, ranks: (read.append(self), at_ranks(self, ranks))[1]
    )
    monkeypatch.setattr(Sketch, "above", lambda self, x: (read.append(self), above(self, x))[1])
    stream = both[1]
    stream.quantile((0.05, 0.5, 0.95), 0.95)
    assert len(read) == 2 * 2 + (0 if stream.independent else 2 * 16)


def test_methods(both):
    """It says how an interval was found, number by number where they differ."""
    stream = both[1]
    if not stream.independent:
        assert (
            stream.quantile(0.5, 0.95).method == "16 replicates"
            and stream.quantile(0.9999, 0.95).method == "counts"
        )
        assert (
            stream.quantile((0.5, 0.9999), 0.95).method
            == "16 replicates, or counts where they are few"
        )
        assert (
            stream.exceedance(1e9).method == "counts"
            and stream.exceedance(1.0).method == "16 replicates"
        )


def test_taken_up_again(tmp_path, monkeypatch):
    """Stopped on the way: the same call goes on, computes no sample twice, and ends with the same
    numbers, to the bit.
    """
    calls, stopped = [], []

    def counted(theta):
        calls.append(len(theta))
        if len(calls) == 9 and not stopped:
            stopped.append(True)
            raise RuntimeError("out of luck")
        return theta.exp()

    monkeypatch.setattr(module, "EVERY", -1.0)
    run = dict(
        function=counted, laws=LAWS, n=4096, replicates=8, chunk=200, out=tmp_path, version=1
    )
    with pytest.raises(RuntimeError, match="out of luck"):
        tb.monte_carlo_stream(**run)
    found = tb.monte_carlo_stream(**run)
    assert sum(calls) == 4096 + 112 and sorted(p.name for p in tmp_path.iterdir()) == [
        "run.json",
        "stream.pt",
    ]
    whole = tb.monte_carlo_stream(**{**run, "out": None})
    assert (found.mean == whole.mean).all() and (found.quantile(0.9) == whole.quantile(0.9)).all()
    calls.clear()
    assert (tb.monte_carlo_stream(**run).kurtosis == whole.kurtosis).all() and not calls
    longer = tb.monte_carlo_stream(**{**run, "n": 8192, "replicates": 16})
    assert sum(calls) == 4096 and longer.samples == 8192
    with pytest.raises(ValueError, match="with the summary of 8192 samples; at least as many"):
        tb.monte_carlo_stream(**run)
    for other, sentence in (
        (dict(n=2048), "another size"),
        (dict(seed=1), "another seed"),
        (dict(design="plain"), "another design"),
    ):
        with pytest.raises(ValueError, match=sentence):
            tb.monte_carlo_stream(**{**run, **other})
    with pytest.raises(ValueError, match="another kept was given"):
        tb.monte_carlo(counted, LAWS, 4096, replicates=8, chunk=200, out=tmp_path, version=1)


def test_a_damaged_summary_is_computed_anew(tmp_path):
    run = dict(function=torch.sin, laws=LAWS, n=512, chunk=32, out=tmp_path)
    whole = tb.monte_carlo_stream(**run)
    path = tmp_path / "stream.pt"
    good = path.read_bytes()
    stored = torch.load(path, weights_only=True)
    stored["stream"].moments[3].mean += 1e-12
    torch.save(stored, path)
    for damaged in (path.read_bytes(), good[:-50], b"", b"no summary"):
        path.write_bytes(damaged)
        with pytest.warns(UserWarning, match=r"stream.pt' is damaged \("):
            assert (tb.monte_carlo_stream(**run).mean == whole.mean).all()


def test_a_full_disk(tmp_path, monkeypatch):
    """The summary does not fit: one sentence, nothing half written; with room, the same call ends
    with the same numbers.
    """
    run = dict(function=torch.sin, laws=LAWS, n=512, chunk=32, out=tmp_path)
    real, synced = os.fsync, []

    def full(file):
        synced.append(file)
        if len(synced) > 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(file)

    monkeypatch.setattr(module, "EVERY", -1.0)
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(
        files.NotWritten, match=r"stream.pt' could not be written: No space left on device"
    ):
        tb.monte_carlo_stream(**run)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.json", "stream.pt"]
    monkeypatch.undo()
    assert (
        tb.monte_carlo_stream(**run).mean == tb.monte_carlo_stream(**{**run, "out": None}).mean
    ).all()


def test_no_worker_waits_for_the_end_of_a_replicate():
    """All chunks of all replicates are given to an executor before the first of them is wanted;
    none is of two replicates.
    """
    given, at_first = [], []

    class Lazy:
        def __init__(self, job):
            self.job = job
            given.append((job.first, job.last))

        def result(self):
            at_first.append(len(given))
            return self.job()

        def cancel(self):
            pass

    class Executor:
        submit = Lazy

    there = tb.monte_carlo_stream(
        function, LAWS, 4 * 40, replicates=4, chunk=16, executor=Executor()
    )
    assert given == [
        (40 * k + a, 40 * k + b) for k in range(4) for a, b in ((0, 16), (16, 32), (32, 40))
    ]
    assert at_first[0] == len(given)
    assert torch.equal(
        there.mean, tb.monte_carlo_stream(function, LAWS, 4 * 40, replicates=4, chunk=16).mean
    )


def test_all_failed():
    none = tb.monte_carlo_stream(lambda theta: theta / 0, LAWS, 64)
    with pytest.raises(ValueError, match="all 64 samples failed"):
        none.mean_interval()


KILLED = """
import os, signal, sys, torch, torchbeam as tb
from torchbeam.uncertainty import monte_carlo_stream as module
module.EVERY = 0.0
torch.set_default_dtype(torch.float64)
left = [int(sys.argv[2])]
def dies(theta):
    if not left[0]:
        os.kill(os.getpid(), signal.SIGKILL)
    left[0] -= 1
    return theta.exp()
found = tb.monte_carlo_stream(dies, {"a": (0.0, 1.0)}, 2**14, chunk=512, out=sys.argv[1], version=1)
print(found.mean.item().hex(), found.quantile(0.99).item().hex())
"""


@pytest.mark.long
def test_killed(tmp_path):
    """kill -9 three times on the way, after 6, 8 and 9 more of 32 chunks: the fourth call ends with
    the numbers of an undisturbed run, by what was left.
    """

    def run(folder, chunks):
        command = [sys.executable, "-c", KILLED, str(tmp_path / folder), str(chunks)]
        return subprocess.run(command, stdout=subprocess.PIPE, text=True)

    for chunks in (6, 8, 9):
        assert run("killed", chunks).returncode == -signal.SIGKILL
    assert (tmp_path / "killed" / "stream.pt").exists()
    assert run("killed", 9).stdout == run("whole", 32).stdout != ""


MEMORY = """
import torch, torchbeam as tb
from torchbeam.core.memory import STATUS, amount
torch.set_default_dtype(torch.float64)
laws = {"EI": tb.laws.LogNormal(1.0, 0.2), "P": tb.laws.Normal(1.0, 0.1)}
def run(n):
    return tb.monte_carlo_stream(lambda x: x[:, 1] / (3 * x[:, 0]), laws, n, chunk=2**14)
run(2**18)
before = amount(STATUS, "VmPeak")
found = run(10_000_000 // 16 * 16)
after = amount(STATUS, "VmPeak")
print(after - before, found.mean.item(), *[x.item() for x in found.mean_interval()])
"""


@pytest.mark.long
def test_ten_million_in_constant_memory():
    """Not 40 MB more of addresses, which no other process takes, than for a 40th of that, where y
    alone would be 80; the mean is (1 + c^2)/3.
    """
    given = subprocess.run(
        [sys.executable, "-c", MEMORY], capture_output=True, text=True, check=True
    ).stdout.split()
    assert int(given[0]) < 40e6
    assert float(given[1]) == pytest.approx(1.04 / 3, rel=1e-6) and float(
        given[3]
    ) <= 1.04 / 3 <= float(given[4])
    assert math.isfinite(float(given[2]))
