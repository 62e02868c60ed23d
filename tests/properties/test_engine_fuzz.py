"""Native code on random scenes: values, statuses, iterations and gradients are the eager ones.

With a line for each scene:  python -m tests.properties.test_engine_fuzz --cases 200
"""

import argparse
import collections
import os
import random
import re
import sys
import time
import warnings
from dataclasses import replace

import pytest
import torch

from tests.cases.gradient_cases import Case, Spec, Unsolved, is_refusal
from tests.cases.gradient_fuzz import NO_SOLUTION, Fuzz

WAYS = (
    "midpoint", "midpoint checkpoint", "midpoint lumped", "midpoint conserve", "stepper midpoint",
    "generalized_alpha", "generalized_alpha checkpoint", "stepper generalized_alpha", "equilibrium",
)  # fmt: skip
# of the largest: both engines solve to 1e-12 of the forces, of which stiff scenes make more
VALUE, GRADIENT = 1e-9, 1e-7
SAMPLES = 3
GIVEN = re.compile("engine = 'compiled'|(was|were) given")  # what sentences of refusals have


def found(spec: Spec, engine: str) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
    """What comes of a scene, and the derivatives of all of it by its tensors: of one sample, and
    values of several.
    """
    os.environ["TORCHBEAM_ENGINE"] = engine
    case = Case(spec)
    x = {name: v.clone().requires_grad_() for name, v in case.draw.tensors.items()}
    total = case(x)
    slopes = (
        torch.autograd.grad(total, list(x.values()), allow_unused=True)
        if total.requires_grad
        else [None] * len(x)
    )
    slopes = {
        name: torch.zeros_like(v) if g is None else g
        for (name, v), g in zip(x.items(), slopes, strict=True)
    }
    with torch.no_grad():
        values = case.blocks(case.draw.tensors)
        scale = 1 + 0.01 * torch.arange(SAMPLES)
        several = {
            name: v if name in case.draw.alone else v * scale[(...,) + (None,) * v.ndim]
            for name, v in case.draw.tensors.items()
        }
        values |= {f"{name} of several": v for name, v in case.blocks(several).items()}
    return values, slopes


def distance(spec: Spec) -> tuple[float, float]:
    """The largest distances of values and of gradients, each of the largest in its tensor
    (gradients: of all).
    """
    (values, slopes), (native, by_native) = (
        found(spec, engine) for engine in ("eager", "compiled")
    )
    apart = max(
        ((a - native[name]).abs().max() / a.abs().max().clamp(min=1e-3)).item()
        for name, a in values.items()
        if a.numel()
    )
    most = max(x.abs().max().item() for x in slopes.values())
    return apart, max((x - by_native[name]).abs().max().item() for name, x in slopes.items()) / max(
        most, 1e-3
    )


class EngineFuzz:
    """Random scenes that native code is to take, of elements of either order: rows (Spec, distance
    of values, of gradients), infinite where one engine fails by an error; refused by sentence.
    """

    def __init__(self, seed: int) -> None:
        self.source, self.rows, self.refused = Fuzz(seed), [], collections.Counter()
        self.random = random.Random(seed)

    def run(self, cases: int, seconds: float = float("inf"), told: bool = False) -> None:
        begin = time.process_time()
        while len(self.rows) < cases and time.process_time() - begin < seconds:
            spec = self.source._spec()
            if spec.way not in WAYS:
                continue
            if self.random.random() < 0.5:  # as many nodes, about
                spec = replace(spec, order=2, count=spec.count - 1)
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    self.rows.append((spec, *distance(spec)))
            except Unsolved:
                continue
            except Exception as error:
                if is_refusal(error):
                    self.refused[str(error)] += 1
                    continue
                if any(sentence in str(error) for sentence in NO_SOLUTION):
                    continue
                print(f"{type(error).__name__}: {str(error)[:200]}", flush=True)
                self.rows.append((spec, float("inf"), float("inf")))
            if told:
                spec, value, gradient = self.rows[-1]
                print(f"{value:.1e} {gradient:.1e} {spec}", flush=True)

    def failures(self) -> list:
        return [row for row in self.rows if not (row[1] <= VALUE and row[2] <= GRADIENT)]


@pytest.mark.always
@pytest.mark.parametrize("cases", [1, pytest.param(100, marks=pytest.mark.long)])
def test_native_code_on_random_scenes(cases, monkeypatch):
    """The scenes of the gradient fuzz, in motion and at rest, alone and several in a batch with
    tensors of their own: engines agree. What native code refuses it refuses in a sentence.
    """
    monkeypatch.setenv("TORCHBEAM_ENGINE", "eager")
    fuzz = EngineFuzz(seed=3 if cases > 1 else 6)  # whose first scene is a small one
    fuzz.run(cases)
    assert len(fuzz.rows) == cases and not fuzz.failures()
    assert all(GIVEN.search(sentence) for sentence in fuzz.refused)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="of CPU, at most")
    arguments = parser.parse_args()
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    fuzz = EngineFuzz(arguments.seed)
    fuzz.run(arguments.cases, arguments.seconds, told=True)
    for sentence, often in fuzz.refused.most_common():
        print(f"refused {often}: {sentence}")
    for row in fuzz.failures():
        print("FAILED", *row)
    print(
        f"{len(fuzz.rows)} scenes, largest distance of values {max(r[1] for r in fuzz.rows):.1e}, "
        f"of gradients {max(r[2] for r in fuzz.rows):.1e}; {len(fuzz.failures())} failures"
    )
    sys.exit(bool(fuzz.failures()))


if __name__ == "__main__":
    main()
