"""Random bad values at random arguments of every public call: it works, or one sentence of the
library's own refuses them; nothing hangs.

What `test_malformed` gives to each argument in turn is fixed; here good values have one thing in
them bad, two arguments are wrong at once, and the calls are also those of results, pictures and
environments.
"""

import inspect
import linecache
import signal
import traceback
from random import Random

import pytest
import torchbeam_envs

import torchbeam
from tests.cases.bad_values import bad, spoilt
from tests.cases.public_calls_of_results import EVERY

LIBRARY = tuple(module.__path__[0] for module in (torchbeam, torchbeam_envs))
# what matplotlib says of its own words; sizes that are asked for, and are honest work
OTHERS = {"color", "bins", "name", "style"}
HONEST = {("advise", "repeats"), ("moment_derivatives", "n"), ("monte_carlo_stream", "n"),
          ("sobol_indices", "n"), ("monte_carlo", "n"), ("rare_event", "n"),
          ("monte_carlo2", "n"), ("rollout", "steps"), ("rollout_jacobian", "steps")}  # fmt: skip
COUNT = 1500
SECONDS = 5  # of CPU time: the machine may be busy


class Hung(BaseException):
    """A call that has not come back in time."""


def hung(*_):
    raise Hung


def fault(error: Exception) -> str | None:
    """What is wrong with a refusal; None: one sentence, raised by the library on purpose."""
    if isinstance(error, OSError) and type(error).__module__.startswith("torchbeam"):
        return None  # a file that is not written
    last = traceback.extract_tb(error.__traceback__)[-1]
    said = str(error)
    if "hostile" in said or not isinstance(
        error, (ValueError, TypeError, IndexError, KeyError, MemoryError, RuntimeError)
    ):
        return f"{type(error).__name__}: {said[:100]}"
    if not said or "\n" in said or len(said) > 400:
        return f"no sentence: {said[:100]!r}"
    if "/tests/" in last.filename or last.name == "entered":
        return None if isinstance(error, (TypeError, KeyError)) else f"raw: {said[:100]}"
    line = linecache.getline(last.filename, last.lineno).strip()
    if not last.filename.startswith(LIBRARY) or not line.startswith("raise"):
        return f"raw {type(error).__name__} at {last.filename}:{last.lineno}: {said[:100]}"
    return None


def arguments(function, given):
    kinds = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY
    named = [p.name for p in inspect.signature(function).parameters.values() if p.kind in kinds]
    return [name for name in dict.fromkeys([*given, *named]) if name not in OTHERS]


def faults(seed, count):
    """(calls that worked, what is wrong with the others) of so many calls. What one is given does
    not depend on which others there are.
    """
    wrong, worked = [], 0
    names = [name for name in EVERY if name != "advise"]  # which measures time, seconds a call
    before = signal.signal(signal.SIGPROF, hung)
    try:
        for k in range(count):
            call = names[k % len(names)]
            random = Random(f"{seed} {call} {k // len(names)}")
            function, given = EVERY[call]
            pool = [n for n in arguments(function, given) if (call, n) not in HONEST]
            asked = dict(given)
            for name in random.sample(pool, min(len(pool), 1 + (random.random() < 0.15))):
                own = name in given and random.random() < 0.5
                asked[name] = spoilt(given[name], random) if own else bad(random)
            what = {name: value for name, value in asked.items() if value is not given.get(name)}
            signal.setitimer(signal.ITIMER_PROF, SECONDS)
            try:
                function(**asked)
                worked += 1
            except Hung:
                wrong.append(f"{call}: no answer in {SECONDS} s to {list(what)}")
            except Exception as error:
                signal.setitimer(signal.ITIMER_PROF, 0)
                if (said := fault(error)) is not None:
                    shown = " ".join(f"{n} = {torchbeam.extend.shown(v)}" for n, v in what.items())
                    wrong.append(f"{call}: {shown}: {said}".encode("ascii", "replace").decode())
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0)
    finally:
        signal.signal(signal.SIGPROF, before)
    return worked, wrong


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.long) for k in range(1, 20))]
)
def test_bad_values_are_refused_in_a_sentence(seed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # files may have any name
    worked, wrong = faults(seed, COUNT)
    assert worked > COUNT / 20  # values that are none of these
    assert not wrong, f"{len(wrong)} of {COUNT}:\n" + "\n".join(wrong[:40])


def test_every_good_call_works():
    """Those of the second half of the table, which nothing else calls."""
    from tests.cases.public_calls_of_results import OF_RESULTS

    for function, given in OF_RESULTS.values():
        function(**given)
