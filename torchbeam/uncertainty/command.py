"""python -m torchbeam montecarlo: a run by a file, here, on all cores, or on a cluster."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor
from contextlib import contextmanager, nullcontext
from inspect import signature
from pathlib import Path
from typing import Any

from ..core.command_line import results_folder
from ..core.files import NotWritten
from ..core.processes import process_pool
from ..core.results import table
from ..core.validation import refusal
from .cluster import connected
from .config import Config, read
from .monte_carlo import monte_carlo
from .monte_carlo_stream import monte_carlo_stream
from .output import write_found

AGAIN = 3  # pools in a row that lose a process before any chunk is done
ROWS = 40  # of the table on the terminal


def main(argv: Sequence[str] | None = None) -> int:
    """Run Monte Carlo from a configuration file: samples in a folder, results with errors."""
    parser = argparse.ArgumentParser(
        prog="python -m torchbeam montecarlo",
        description=(
            "Evaluates a function at samples of random parameters, and writes the samples, "
            "summary.json and summary.csv. The same command goes on with a run that was stopped."
        ),
    )
    parser.add_argument(
        "config",
        type=Path,
        metavar="CONFIG",
        help="a .py file with function, laws and n, and options of tb.monte_carlo; or .json or "
        ".toml with the "
        'same, where function is "FILE.py:NAME"',
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for samples and answers"
    )
    parser.add_argument("--n", type=int, help="samples, in place of those of the configuration")
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="of a Dask cluster: tcp://HOST:8786, or the .json file that its scheduler writes "
        "(extra mc)",
    )
    where.add_argument(
        "--workers", type=int, default=None, metavar="N", help="processes here, of one thread each"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress on the terminal")
    arguments = parser.parse_args(argv)
    if arguments.workers is not None and arguments.workers < 1:
        parser.error(f"--workers {arguments.workers} was given; at least 1 is wanted")
    try:
        config = read(arguments.config)
    except ValueError as error:
        parser.error(str(error))
    out = results_folder(parser, arguments.out)
    try:
        result = _run(config, arguments, out / "samples")
    except NotWritten:
        raise
    except (ValueError, MemoryError, ImportError) as error:
        parser.error(str(error))
    except KeyboardInterrupt:
        print("\nstopped; the same command goes on where it was", file=sys.stderr)
        return 130
    except (CancelledError, BrokenExecutor, OSError) as error:
        why = ": ".join(filter(None, (type(error).__name__, str(error))))
        print(
            f"\nthe workers were lost ({why}); the same command goes on where it was",
            file=sys.stderr,
        )
        return 1
    _report(config, result, out)
    return 0


def _run(config: Config, arguments: argparse.Namespace, out: Path) -> Any:
    """Samples or stream of a configuration."""
    run: Callable[..., Any] = monte_carlo if config.keep else monte_carlo_stream
    if unknown := [name for name in config.options if name not in signature(run).parameters]:
        raise ValueError(
            f"{unknown[0]!r} was given with keep = {config.keep}; {run.__name__} has no such option"
        )
    n = config.n if arguments.n is None else arguments.n
    if n is None and "theta" not in config.options:
        raise refusal("a configuration without n", "n, or --n,")
    for trial in range(AGAIN):
        before = _files(out)
        with _executor(arguments, config) as executor:
            try:
                asked = (config.function, config.laws, *(() if n is None else (n,)))
                told = None if arguments.quiet else True
                return run(*asked, out=out, executor=executor, progress=told, **config.options)
            except BrokenExecutor:
                if arguments.workers is None or (trial == AGAIN - 1 and _files(out) == before):
                    raise
                print("\na worker was lost; on with new ones", file=sys.stderr)
    raise BrokenExecutor(f"{AGAIN} pools of workers were lost")


def _executor(arguments: argparse.Namespace, config: Config) -> Any:
    if arguments.scheduler is not None:
        return connected(arguments.scheduler, config.modules)
    if arguments.workers is not None:
        return _pool(arguments.workers)
    return nullcontext()


@contextmanager
def _pool(workers: int) -> Any:
    """Processes on this machine; without waiting for chunks that are not begun, after an error."""
    pool: Executor = process_pool(workers)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def _files(folder: Path) -> int:
    return sum(1 for _ in folder.glob("*.pt"))


def _report(config: Config, result: Any, out: Path) -> None:
    """Summaries as files and as a table."""
    summary = result.summary(config.levels, config.interval, config.thresholds)
    for kind in ("json", "csv"):
        write_found(out / f"summary.{kind}", summary)
    print(result)
    columns, statistics = ("quantity", "y", "estimate", "low", "high"), summary["statistics"]
    rows = [
        [
            *(row[key] for key in columns[:2]),
            *("-" if row[key] is None else f"{row[key]:.6g}" for key in columns[2:]),
        ]
        for row in statistics[:ROWS]
    ]
    print(table(columns, rows, 2))
    if len(statistics) > ROWS:
        print(f"and {len(statistics) - ROWS} more rows in {out / 'summary.csv'}")
