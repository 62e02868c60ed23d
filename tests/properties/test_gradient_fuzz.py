"""Gradients of random scenes by everything that they are made of: reverse mode = forward
mode = differences.

With a table of all derivatives:  python -m tests.properties.test_gradient_fuzz --cases 1000 --out
                                  out/gradients.csv
"""

import argparse
import itertools
import sys
import time
from pathlib import Path

import pytest
import torch

from tests.cases.gradient_fuzz import Fuzz


@pytest.mark.parametrize("cases", [16, pytest.param(1000, marks=pytest.mark.long)])
def test_gradients_of_random_scenes(cases, monkeypatch):
    """Every argument of every effect, section, beam, support and motion, times and starts; in 3D,
    in planes and for small rotations; equilibria, both implicit methods with and without
    checkpoint, and the explicit forms: the derivative of a random mix of all that comes out, by
    each tensor, in reverse mode = in forward mode = by differences, to 1e-5 and the noise that the
    differences tell of themselves. What does not go together is refused in a sentence.

    By eager steps: each scene is another structure, of one step or two, and test_engine_fuzz.py
    holds that native gradients of these scenes are the same.
    """
    monkeypatch.setenv("TORCHBEAM_ENGINE", "eager")
    fuzz = Fuzz(seed=1, crowded=cases < 100)
    fuzz.run(cases)
    assert not fuzz.failures
    assert not fuzz.missing()
    resolved = [r for _, r in fuzz.rows if r.resolved]
    assert len(resolved) > 0.8 * len(fuzz.rows)  # a test of noise alone would hold nothing


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--out", type=Path, default=Path("out/gradients.csv"), help="CSV of all derivatives"
    )
    parser.add_argument("--seconds", type=float, default=float("inf"), help="of CPU, at most")
    arguments = parser.parse_args()
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    begin, fuzz = time.process_time(), Fuzz(arguments.seed)
    fuzz.run(arguments.cases, arguments.seconds)
    fuzz.save(arguments.out)
    for sentence, often in fuzz.refused.most_common():
        print(f"refused {often}: {sentence}")
    for s, r in itertools.islice(
        sorted((x for x in fuzz.rows if x[1].resolved), key=lambda x: -x[1].error / x[1].size), 5
    ):
        print(f"{r.error / r.size:.2g} {r}   {s}")
    print("never ran:", sorted(map(str, fuzz.missing())) or "nothing")
    print(fuzz.report(), f"; {time.process_time() - begin:.0f} s of one core")
    sys.exit(bool(fuzz.failures))


if __name__ == "__main__":
    main()
