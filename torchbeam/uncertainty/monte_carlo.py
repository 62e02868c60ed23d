"""Monte Carlo evaluation of a function of random parameters, in chunks that can be resumed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import boolean, choice
from ..core.docstrings import with_arguments_of
from ..core.files import path_of
from ..core.memory import check_memory
from ..core.validation import Value, as_tensor, finite, refusal, shown
from .chunks import ChunkFolder, chunk_size, usual_chunk
from .designs import Given, Plain, Sobol
from .estimate import Estimate
from .evaluation import Evaluation, Function, one_kind, points_of, progress_of, settings
from .joint_law import Correlation, JointLaw
from .laws import Law
from .progress import Report
from .samples import Samples, checked_sentences

DESIGNS = {"sobol": Sobol, "plain": Plain}
FEWEST, MOST = 8, 64  # replicates of a run until an error is reached
LEVEL = 0.95  # of the interval that `until` is about
Until = float | tuple[float, Callable[[Samples], Estimate]]


class EvaluationOptions:
    """Options of a function's evaluation at samples of its parameters, chunk by chunk.

    Args:
        chunk: number of samples a call. Chunk i is a function of (seed, i) alone, whichever process
            computes it, and when. None: 256; 512 from 32,768 samples on, 1,024 from 65,536 on.
            "auto": measured, from throughput and memory. A folder keeps its own number in both
            cases
        executor: any concurrent.futures.Executor, such as ProcessPoolExecutor, or a Dask cluster's
            Client.get_executor(); None = this process, chunk after chunk. With an executor,
            function and laws must pickle; other processes compute on one thread. Forked ones may
            wait for ever where torch has used threads: mp_context=get_context("spawn") is safe
        out: a folder with a file for each chunk. Existing chunks are not computed again: a killed
            run continues, and so does a run with a larger n. (With `replicates`, n grows by more
            replicates of the same size; with your own `theta` it cannot grow.) A damaged chunk is
            computed again, with a warning. A folder of another run is refused: of other laws or
            their order, correlation, design, seed, chunk, dtype, release of this library, or
            function
        dtype: of theta; None = torch.float64
        version: your text or number that changes with the function, for `out`. None: its code, and
            the values that its code refers to, identify the function; a FutureWarning tells where
            some of these are out of sight. Values that the function itself changes do not count
        by_name: True: the function takes its parameters by name: f(EI=(N,), mass=(N,)), a field as
            (N, places)
        sentences: meaning of each status of the function, {3: "buckled"}: reasons of failed samples
        progress: a function of the `Progress`, called after each chunk; or True: a line on the
            terminal
    """


@with_arguments_of(EvaluationOptions)
def monte_carlo(
    function: Function,
    laws: Mapping[str, Law] | Sequence[str],
    n: int | None = None,
    *,
    correlation: Correlation | None = None,
    theta: Value | None = None,
    design: str = "sobol",
    replicates: int | None = None,
    until: Until | None = None,
    seed: int = 0,
    chunk: int | str | None = None,
    executor: Executor | None = None,
    out: str | Path | None = None,
    dtype: torch.dtype | None = None,
    version: str | int | None = None,
    by_name: bool = False,
    sentences: Mapping[int, str] | None = None,
    progress: Report | bool | None = None,
) -> Samples:
    """Evaluate a function at n samples of parameters, in chunks.

    Args:
        function: theta (N, p) -> y (N, ...), batched: sample i of y depends on sample i of theta
            alone. (A mean over the batch would depend on `chunk`, and is not detected.) Or the
            function returns (y, status (N,)), with a status other than 0 for failed samples
        laws: by name, in the order of theta's columns. A law is (least, largest) for a uniform law,
            a law of `tb.laws`, or any object with `icdf` or `ppf`, as those of torch.distributions
            and scipy.stats, old and new. It may also be a function of u (N,), uniform in (0, 1),
            that returns (N,). A `RandomField` has a column for each place
        n: number of samples of a scrambled Sobol sequence (Matousek 1998), best a power of two. A
            longer run with the same seed has the same first n samples. (y differs by rounding if
            the longer run uses native code)
        correlation: (p, p) of the laws, or {("EI", "mass"): 0.5}: of their normal scores, by a
            Gaussian copula
        theta: (n, p) your own samples in place of a design; `laws` are then names, or laws that are
            not used
        design: "sobol", or "plain": independent samples
        seed: a whole number; the same seed gives the same samples
        replicates: number of independent Sobol sequences, which share n; their scatter gives
            intervals. 16 are a good number, each best with a power of two samples. None: a single
            sequence, with the intervals of independent samples, which are too wide
        until: relative error of the mean: half its 95 % interval over the mean, in each number of
            y. Replicates (64 by default) are computed until it is reached; n is the most. Or
            (error, lambda samples: Estimate) for another quantity, such as (0.02, lambda samples:
            samples.quantile(0.99, 0.95)). Each check, at 8, 12, 16 ..., shortens intervals a bit

    A sample that the function refuses by a ValueError has the status -1, a y that is not finite 1.
    Answers are detached, on the CPU.

    Raises:
        ValueError: for invalid laws, a function whose y does not fit, and a folder of another run
            or that cannot be written.
        files.NotWritten: an OSError, where the disk is full. The same call continues later.
        MemoryError: for more samples than fit in memory (`tb.monte_carlo_stream` keeps none).

    Examples:
        >>> samples = tb.monte_carlo(deflection, laws, 256, by_name=True)
        >>> samples.mean, samples.quantile(0.95).shape
        (tensor(0.3367), torch.Size([]))
    """
    joint, theta = _law_and_samples(laws, theta, n, dtype, correlation)
    n = n if theta is None else len(theta)
    choice("design", design, DESIGNS)
    out = None if out is None else path_of("out", out)
    boolean("by_name", by_name)
    reasons = checked_sentences(sentences)
    auto, usual = isinstance(chunk, str) and chunk == "auto", chunk is None
    chunk = 1 if auto or usual else chunk
    n, seed, chunk, dtype = settings(function, n, seed, chunk, executor, dtype, version)
    n, points = _shares(n, replicates, until, None if theta is None else "theta")
    plan: Any = DESIGNS[design](joint.dimension, seed, points)
    plan = plan if theta is None else Given(theta.to(dtype))
    work = Evaluation(function, joint, plan, dtype, 1, by_name, executor, total=n)
    if usual or auto:
        chunk = chunk_of(out) or (usual_chunk(n) if usual else chunk_size(work))
    label = dict(seed=seed, chunk=chunk, dtype=str(dtype), **plan.label)
    folder = folder_of(out, function, joint, version, **label)
    work = replace(work, chunk=chunk, folder=folder)
    return _sampled(work, n, points, until, reasons, progress_of(progress, n))


def _sampled(
    work: Evaluation,
    n: int,
    points: int | None,
    until: Until | None,
    reasons: dict[int, str],
    at: Any,
) -> Samples:
    """What is computed of n samples, stage by stage until the error is reached."""
    done, chunks, plan = 0, [], work.design
    for end in _stages(n, points, until):
        for part in work.chunks(done, end, at):
            if not chunks:
                size = 2 * n * sum(x[0].numel() * x.element_size() for x in part)
                what = f"{n} samples of y {tuple(part[1].shape[1:])}"
                check_memory(what, size, "monte_carlo_stream keeps none")
            chunks.append(part)
        done = end
        firsts = torch.tensor([0, *(len(c[0]) for c in chunks)]).cumsum(0).tolist()
        one_kind(zip(firsts, chunks, strict=False))
        columns = (torch.cat(part) for part in zip(*chunks, strict=True))
        several = 1 if plan.independent or points is None else done // points
        samples = Samples(work.joint.names, *columns, several, plan.independent, reasons)
        if until is not None and _reached(samples, until):
            break
    return samples


def folder_of(
    out: str | Path | None,
    function: Function,
    joint: JointLaw,
    version: str | int | None,
    **settings_: Any,
) -> ChunkFolder | None:
    """Folder of a run, known by its function, laws and settings; None where none is wanted."""
    if out is None:
        return None
    mixed = {} if joint.correlation is None else {"correlation": joint.correlation.tolist()}
    return ChunkFolder.of(
        out, function, joint.laws, None if version is None else str(version), **settings_, **mixed
    )


def chunk_of(out: str | Path | None) -> int | None:
    """Chunk of the run that is in a folder; None where there is none."""
    size = None if out is None else ChunkFolder.setting(out, "chunk")
    return size if isinstance(size, int) and size > 0 else None


def _law_and_samples(
    laws: Any, theta: Value | None, n: int | None, dtype: torch.dtype | None, correlation: Any
) -> tuple[JointLaw, Tensor | None]:
    """The joint law, and None; or names as one that is not used, and the user's samples (n, p)."""
    if theta is None:
        return JointLaw.of(laws, correlation), None
    if correlation is not None:
        raise ValueError(
            "a correlation was given beside theta, which holds the samples themselves; one of "
            "the two is wanted"
        )
    joint = JointLaw.of(laws) if isinstance(laws, Mapping) else JointLaw(_named(laws))
    theta = finite("theta", as_tensor(theta, dtype or torch.float64)).detach().cpu()
    if theta.ndim != 2 or not len(theta) or theta.shape[1] != len(joint.names):
        raise ValueError(
            f"theta {tuple(theta.shape)} was given; (n, {len(joint.names)}) is wanted, a column "
            f"for each of {', '.join(joint.names)}"
        )
    if n is not None and n > len(theta):
        raise ValueError(
            f"n = {n} was given with {len(theta)} rows of theta; at most as many are wanted"
        )
    return joint, theta[:n]


def _named(names: Any) -> dict[str, None]:
    """Names of columns, with no laws."""
    known = isinstance(names, Sequence) and not isinstance(names, str) and names
    if not known or not all(isinstance(x, str) for x in names) or len(set(names)) < len(names):
        raise ValueError(
            f"laws = {shown(names)} were given with theta; names, one for each column, are wanted"
        )
    return dict.fromkeys(names)


def _shares(
    n: int, replicates: int | None, until: Until | None, other: str | None
) -> tuple[int, int | None]:
    """Samples of all replicates, and of each (None = there is one)."""
    if replicates is None and until is None:
        return n, None
    if other is not None:
        raise ValueError(
            f"replicates or until were given beside {other}; samples of your own are one design"
        )
    if until is not None:
        error, _ = _goal(until)
        if isinstance(error, bool) or not isinstance(error, (int, float)) or not 0 < error < 1:
            raise ValueError(
                f"until = {shown(until)} was given; a relative error between 0 and 1 is wanted, or "
                "one and a function of samples"
            )
    if replicates is None:
        # a power of two, so that at least MOST fit
        points = max(2 ** max((n // MOST).bit_length() - 1, 0), 1)
    else:
        points = points_of(n, replicates)
        if replicates == 1 and until is None:
            return n, None
    if n // points < FEWEST and until is not None:
        raise ValueError(
            f"n = {n} was given with until, for {n // points} replicates; at least {FEWEST} are "
            "wanted"
        )
    return n // points * points, points


def _stages(n: int, points: int | None, until: Until | None) -> Iterator[int]:
    """Numbers of samples after which the error is looked at; the last is n."""
    if until is not None:
        step, k = FEWEST // 2, FEWEST
        while k * points < n:
            yield k * points
            k += step
            step = 2 * step if k == 4 * step else step
    yield n


def _goal(until: Any) -> tuple[Any, Callable[[Samples], Estimate]]:
    """The relative error that is wanted, and of which statistic."""
    if isinstance(until, (tuple, list)) and len(until) == 2 and callable(until[1]):
        return until[0], until[1]
    return until, lambda samples: samples.mean_interval(LEVEL)


def _reached(samples: Samples, until: Until) -> bool:
    if not (samples.status == 0).any():
        return False
    error, statistic = _goal(until)
    estimate = statistic(samples)
    if not isinstance(estimate, Estimate):
        raise refusal(
            f"until with a function that gave a {type(estimate).__name__}",
            "a torchbeam.Estimate, with its interval,",
        )
    return bool((estimate.relative_error <= error).all())
