"""monte_carlo: laws, chunks, executors, files, failures; refusals."""

import json
import math
import os
import signal
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np
import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam.core.repetition import repetitions

NORMAL = torch.distributions.Normal(
    torch.tensor(1.0, dtype=torch.float64), torch.tensor(0.2, dtype=torch.float64)
)
LAWS = {"a": (0.0, 2.0), "b": NORMAL, "c": torch.exp}
CALLS = []


def product(theta):
    CALLS.append(len(theta))
    return theta.prod(-1, keepdim=True)


def test_laws():
    """Mean and deviation of each column: uniform on (0, 2), normal, exp of uniform. n = 1024 of a
    scrambled Sobol sequence: means are good to 1e-3 (plain sampling: 2e-2).
    """
    found = tb.monte_carlo(product, LAWS, 1024)
    assert (
        found.names == ("a", "b", "c")
        and found.theta.shape == (1024, 3)
        and found.y.shape == (1024, 1)
    )
    assert_close(found.theta.mean(0), torch.tensor([1.0, 1.0, math.e - 1]), rtol=0, atol=1e-3)
    assert_close(found.theta.std(0)[:2], torch.tensor([2 / 12**0.5, 0.2]), rtol=1e-2, atol=0)
    assert_close(found.mean, torch.tensor([math.e - 1]), rtol=0, atol=5e-3)
    assert_close(found.quantile([0.5]), found.y.quantile(0.5, 0)[None])


def test_chunks_do_not_matter():
    """Any chunk size, an executor, a longer run: the same samples, to the bit."""
    whole = tb.monte_carlo(product, LAWS, 100, chunk=100)
    with ThreadPoolExecutor(2) as pool:
        others = [
            tb.monte_carlo(product, LAWS, 100, chunk=7),
            tb.monte_carlo(product, LAWS, 100, chunk=32, executor=pool),
            tb.monte_carlo(product, LAWS, 130, chunk=64),
        ]
    for other in others:
        assert (other.theta[:100] == whole.theta).all() and (other.y[:100] == whole.y).all()
    assert not (tb.monte_carlo(product, LAWS, 100, seed=1).theta == whole.theta).any()


def test_the_default_dtype_does_not_matter():
    """A worker may have another one: the samples are those that were asked for, to the bit."""
    here = tb.monte_carlo(product, LAWS, 8)
    torch.set_default_dtype(torch.float32)
    there = tb.monte_carlo(product, LAWS, 8)
    assert (here.theta == there.theta).all() and there.y.dtype == torch.float64
    assert tb.monte_carlo(product, LAWS, 8, dtype=torch.float32).y.dtype == torch.float32


def test_other_processes():
    """Two spawned workers: what this process gets, to the bit; and no open file stays behind a
    chunk.
    """
    before, opened = _open_files(), []
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        there = tb.monte_carlo(
            torch.sin, LAWS, 64, chunk=1, executor=pool,
            progress=lambda _: opened.append(_open_files()),
        )  # fmt: skip
    assert (there.y == tb.monte_carlo(torch.sin, LAWS, 64, chunk=1).y).all()
    # pipes of two processes, and nothing that is left of each chunk
    assert max(opened) < before + 32


def _open_files():
    return len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 0


def _dies_once(folder, theta):
    """The process that first gets to its fourth chunk is killed; no other after it."""
    (folder / f"{os.getpid()}-{len([*folder.iterdir()])}").touch()
    if len([*folder.glob(f"{os.getpid()}-*")]) == 4:
        try:
            (folder / "killed").touch(exist_ok=False)
            os.kill(os.getpid(), signal.SIGKILL)
        except FileExistsError:
            pass
    return theta.sin()


def test_a_cluster_that_loses_a_worker(tmp_path):
    """Dask, two workers, one killed on the way: all samples, to the bit."""
    distributed = pytest.importorskip("distributed")
    options = dict(n_workers=2, threads_per_worker=1, dashboard_address=None)
    calls, out = tmp_path / "calls", tmp_path / "out"
    calls.mkdir()
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
        there = tb.monte_carlo(
            partial(_dies_once, calls), LAWS, 64, chunk=8, executor=client.get_executor(retries=3),
            out=out, version=1,
        )  # fmt: skip
    assert (calls / "killed").exists()
    assert (there.y == tb.monte_carlo(torch.sin, LAWS, 64).y).all() and len([*out.iterdir()]) == 9


def test_taken_up_again(tmp_path):
    """A file a chunk; a missing one alone is computed again, a larger n adds, a smaller one reads;
    nothing half written.
    """
    whole = tb.monte_carlo(product, LAWS, 40, chunk=16, out=tmp_path)
    files = sorted(p.name for p in tmp_path.iterdir())
    assert files == ["chunk-000000000.pt", "chunk-000000016.pt", "chunk-000000032.pt", "run.json"]
    assert json.loads((tmp_path / "run.json").read_text())["function"] == "product"
    (tmp_path / "chunk-000000016.pt").unlink()
    CALLS.clear()
    again = tb.monte_carlo(product, LAWS, 40, chunk=16, out=tmp_path)
    assert CALLS == [16] and (again.y == whole.y).all()
    longer = tb.monte_carlo(product, LAWS, 70, chunk=16, out=tmp_path)
    assert CALLS == [16, 16, 16, 6] and (longer.y[:40] == whole.y).all()  # the third chunk had 8
    assert (
        tb.monte_carlo(product, LAWS, 20, chunk=16, out=tmp_path).y == whole.y[:20]
    ).all() and len(CALLS) == 4


def test_failed_samples_keep_their_place():
    """y that is not finite, and what the function itself says failed; statistics are of the
    others.
    """

    def half(theta):
        y = torch.where(theta[:, 0] > 1.5, torch.nan, theta[:, 0])
        return y, (theta[:, 0] < 0.5).long() * 3

    found = tb.monte_carlo(half, {"a": (0.0, 2.0)}, 256, chunk=50)
    a = found.theta[:, 0]
    assert ((found.status == 1) == (a > 1.5)).all() and ((found.status == 3) == (a < 0.5)).all()
    assert_close(found.mean, torch.tensor(1.0), rtol=0, atol=1e-2)
    assert "128 failed" in repr(found)


def test_an_error_leaves_what_was_done(tmp_path):
    """The function raises in the third chunk: the first two are there."""

    def fails(theta):
        if len(list(tmp_path.glob("chunk-*.pt"))) == 2:
            raise RuntimeError("out of luck")
        return theta

    with pytest.raises(RuntimeError, match="out of luck"):
        tb.monte_carlo(fails, LAWS, 64, chunk=16, out=tmp_path)
    assert len(list(tmp_path.iterdir())) == 3


def test_beams():
    """Deflections of beams of scattered stiffness: small loads, w = P
    L^3/(3 EI)(1 + 1/(2 N^2))^-1..., mean of 1/EI known.
    """

    def deflection(theta):
        section = tb.Section.from_stiffness(
            EA=math.inf, GA=math.inf, GJ=1.0, EI=theta[:, 0], mass=1.0
        )
        state = tb.equilibrium(
            tb.Scene(tb.Beam.straight(1.0, 4, section), [tb.TipLoad(force=(0, 0, 1e-4))]),
            throw=False,
        )
        return state.tip.position[:, 2], state.status

    found = tb.monte_carlo(deflection, {"EI": (1.0, 2.0)}, 64)
    one = deflection(torch.tensor([[1.0]]))[0][0]  # w EI
    assert_close(found.mean, one * math.log(2), rtol=1e-3, atol=0)


def test_chunks_that_nobody_chose(tmp_path):
    """256; of many samples up to 1,024, and in a folder what that has. What the function calls
    knows how many there are.
    """
    sizes = []

    def noted(theta):
        sizes.append((len(theta), len(theta) * repetitions()))
        return theta[:, 0]

    for n, chunk in ((100, 100), (1000, 256), (2**15, 512), (10**5, 1024)):
        sizes.clear()
        tb.monte_carlo(noted, LAWS, n)
        assert sizes[0] == (chunk, pytest.approx(n)) and sum(size for size, _ in sizes) == n
    tb.monte_carlo(noted, LAWS, 100, chunk=64, out=tmp_path, version=1)
    sizes.clear()
    tb.monte_carlo(noted, LAWS, 200, out=tmp_path, version=1)
    assert [size for size, _ in sizes] == [64, 64, 8] and repetitions() == 1


def test_constants_alone():
    """Laws without scatter, and a correlation of none of them: the same sample again and again."""
    laws = {"a": tb.laws.Constant(1.0), "b": tb.laws.Constant(2.0)}
    for correlation in (None, {}, torch.eye(2)):
        assert (tb.monte_carlo(product, laws, 4, correlation=correlation).y == 2).all()


def test_half_precision_is_kept_as_single():
    """A y of a network in bfloat16: NumPy, and so a table, knows no such numbers."""
    found = tb.monte_carlo(lambda theta: theta[:, 0].bfloat16(), LAWS, 8)
    assert found.y.dtype == torch.float32 and torch.isfinite(found.mean)


# fmt: off
CASES = {
    "no laws": (dict(laws={}), "no laws were given"),
    "no function": (dict(function=3), "function = 3 was given"),
    "complex numbers": (dict(function=lambda theta: 1j * theta),
                        "gave a complex y was given; real numbers"),
    "law as a number": (dict(laws={"a": 1.0}), "the law 1.0 was given for 'a'"),
    "law upside down": (dict(laws={"a": (2.0, 1.0)}), r"\(least, largest\) is wanted"),
    "no samples": (dict(n=0), "n = 0"),
    "no chunk": (dict(chunk=0), "chunk = 0"),
    "laws as a list": (dict(laws=[(0.0, 1.0)]), r"laws = \[\(0.0, 1.0\)\] was given; a dict"),
    "law without a name": (dict(laws={0: (0.0, 1.0)}), "a law was given for 0; a name"),
    "law without end": (dict(laws={"a": (0.0, math.inf)}), r"\(least, largest\) is wanted"),
    "law of one number": (dict(laws={"a": lambda u: u.mean()}),
                          r"a law of 'a' that gave \(\) for u \(8,\)"),
    "law that is no tensor": (dict(laws={"a": lambda u: 1.0}), "a law of 'a' that gave a float"),
    "law that fails": (dict(laws={"a": lambda u: (u - 0.5).log()}),
                       "a law of 'a' that gave numbers that are not finite"),
    "seed": (dict(seed="a"), "seed = 'a' was given"),
    "negative seed": (dict(seed=-1), "seed = -1 was given"),
    "dtype": (dict(dtype=torch.int64), "torch.int64 was given"),
    "dtype by name": (dict(dtype="float64"), "dtype = 'float64' was given"),
    "executor": (dict(executor=4), "executor = 4 was given"),
    "version": (dict(version=1.5), "version = 1.5 was given"),
    "y that is no tensor": (dict(function=lambda theta: theta.tolist()), "gave y as a list"),
    "a status too short": (dict(function=lambda theta: (theta, torch.zeros(3))),
                           r"gave a status \(3,\) was given; \(8,\)"),
    "sentences": (dict(sentences="buckled"),
                  "sentences = 'buckled' were given; a dict, status -> text"),
    "sentences by text": (dict(sentences={"3": "buckled"}), "a dict, status -> text, is wanted"),
    "constants with a correlation": (dict(laws={"a": tb.laws.Constant(1.0),
                                                "b": tb.laws.Constant(2.0)},
                                          correlation={("a", "b"): 0.5}),
                                     "of 'a' was given, which is a constant"),
    "several correlations": (dict(correlation={("a", "b"): [0.1, 0.2]}),
                             r"the correlation of \('a', 'b'\) = \[0.1, 0.2\] was"),
    "a correlation of lists": (dict(correlation={(("a",), "b"): 0.1}),
                               r"a correlation of \(\('a',\), 'b'\) was given; two of"),
    "path": (dict(out=3), "out = 3 was given; a path is wanted"),
    "no path": (dict(out=""), "out = '' was given; a path is wanted"),
    "chunk as an array": (dict(chunk=np.array([1, 2])),
                          r"chunk = array\(\[1, 2\]\) was given; a whole number"),
    "progress as a tensor": (dict(progress=torch.ones(2)),
                             "progress = tensor.* was given; a function of progress is wanted"),
    "y without numbers": (dict(function=lambda theta: theta[:, :0]), r"gave y \(8, 0\) was given"),
    "y on no device": (dict(function=lambda theta: theta.to("meta")), "on meta was given; numbers"),
    "a sparse y": (dict(function=lambda theta: theta.to_sparse()),
                   "in the layout torch.sparse_coo"),
    "half a status": (dict(function=lambda theta: (theta, theta[:, 0] * 0 + 0.5)),
                      "a status between whole numbers"),
    "a complex status": (dict(function=lambda theta: (theta, theta[:, 0] * 1j)),
                         "a complex status was given"),
    "law without quantiles": (dict(laws={"a": torch.distributions.Gamma(1.0, 2.0)}),
                              r"which has no quantiles \(icdf\); an"),
    "law of as many numbers": (dict(laws={"a": torch.distributions.Normal(torch.zeros(8), 1.0)}),
                               r"which has \(8,\) numbers"),
    "y of two kinds": (dict(function=lambda theta: theta.new_zeros(len(theta), len(theta)),
                            chunk=5), "from sample 5 on"),
    "columns by name": (dict(function=lambda theta: theta["a"]), "by_name=True is wanted"),
    "arguments by name": (dict(function=lambda a, b, c=1: a * b, laws={k: LAWS["a"] for k in "ab"}),
                          "by_name=True is wanted, and a function of a, b, or theta"),
    "other arguments": (dict(function=lambda load, span: load), "a function of theta is wanted"),
    "another y": (dict(function=lambda theta: theta[:2]),
                  r"y \(2, 3\) was given; \(8, ...\) is wanted"),
}
# fmt: on


@refusals(CASES)
def test_refused(changed):
    tb.monte_carlo(**{**dict(function=product, laws=LAWS, n=8), **changed})
