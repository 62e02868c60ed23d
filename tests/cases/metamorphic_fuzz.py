"""Random scenes said twice: draws, compares, counts, and makes what failed small."""

from __future__ import annotations

import collections
import csv
import time
import traceback
import warnings
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch

from tests.cases.gradient_cases import Case, Spec, Unsolved, is_refusal
from tests.cases.gradient_fuzz import NO_SOLUTION, Fuzz
from tests.cases.metamorphic_answers import ANSWERS
from tests.cases.metamorphic_parts import NotHere
from tests.cases.metamorphic_relations import RELATIONS, VALUES_ONLY
from tests.cases.metamorphic_said import Said, engine

# of the largest: both solve to 1e-12 of the forces, of which stiff scenes make more
VALUE, GRADIENT = 1e-8, 1e-6
# of values with adaptive steps, whose lengths are found to the precision of their errors
CONTROLLED = 1e-6
# of values in single precision: its rounding, 6e-8, times what unlike stiffnesses make of it
SINGLE = 1e-3
# of values of numbers that tests compute in single precision before a scene has them
DEFAULT = 1e-5
SMALL = 1e-6  # of an output (m, rad, N, J): what is smaller is rounding of what is larger


class Row(NamedTuple):
    spec: Spec
    answer: str
    relation: str
    engine: str
    value: float
    gradient: float
    where: str = ""

    def worse(self, name: str, apart: float, where: str) -> Row:
        """With the larger of two distances; NaN is the largest."""
        apart = apart if apart == apart else float("inf")
        return (
            self if apart <= getattr(self, name) else self._replace(**{name: apart, "where": where})
        )

    @property
    def passed(self) -> bool:
        if self.relation == "single precision":
            return self.value <= SINGLE
        if self.relation == "default dtype":
            return self.value <= DEFAULT
        loose = CONTROLLED / VALUE if self.answer.startswith("rtol") else 1.0
        return self.value <= VALUE * loose and self.gradient <= GRADIENT * loose


def said(spec: Spec, answer: str, gradient: bool = True) -> Said:
    case = Case(spec)
    gradient = gradient and ANSWERS[answer].gradient
    return Said(
        spec,
        answer,
        {n: v.clone().requires_grad_(gradient) for n, v in case.draw.tensors.items()},
        case,
    )


def compare(of: Said, relation: str, by: str = "eager") -> Row:
    """One relation on one scene. Raises NotHere where it says nothing, Unsolved where the scene has
    no answer, ValueError where it is refused.
    """
    with_gradient = any(v.requires_grad for v in of.x.values()) and relation not in VALUES_ONLY
    with (
        warnings.catch_warnings(),
        engine(by),
        torch.set_grad_enabled(with_gradient or relation == "dual"),
    ):
        warnings.simplefilter("ignore")
        a, b = RELATIONS[relation](of)
        row = Row(of.spec, of.answer, relation, by, 0.0, 0.0)
        for name in a:
            if a[name].shape != b[name].shape:
                return row._replace(
                    value=float("inf"),
                    where=f"{name}: {tuple(a[name].shape)} and {tuple(b[name].shape)}",
                )
            if a[name].numel():
                size = a[name].detach().abs().amax().clamp(min=SMALL)
                row = row.worse(
                    "value", ((a[name] - b[name]).detach().abs().max() / size).item(), name
                )
        if not with_gradient or not row.passed:
            return row
        first, second = (_slopes(blocks, a, of.x) for blocks in (a, b))
        sizes = of.case.draw.size
        size = max(1e-3, *((s.abs().max() * sizes[n]).item() for n, s in first.items()))
        for n, v in first.items():
            row = row.worse(
                "gradient",
                ((v - second[n]).abs().max() * sizes[n]).item() / size,
                f"gradient by {n}",
            )
        return row


def _slopes(blocks: dict, like: dict, x: dict) -> dict:
    """Derivatives of all numbers in fixed proportions."""
    draw, total = torch.Generator().manual_seed(1), torch.zeros(())
    for name in sorted(like):
        if like[name].numel():
            w = torch.randn(like[name].shape, generator=draw)
            total = total + (w * blocks[name]).sum() / like[
                name
            ].detach().square().mean().sqrt().clamp(min=1e-3)
    found = [None] * len(x)
    if total.requires_grad:
        found = torch.autograd.grad(total, list(x.values()), allow_unused=True, retain_graph=True)
    return {
        n: torch.zeros_like(v) if g is None else g
        for (n, v), g in zip(x.items(), found, strict=True)
    }


class Metamorphic:
    """A run: rows, failures (what, how), refused by sentence, and how often each relation, answer,
    ingredient was compared.
    """

    def __init__(
        self,
        seed: int,
        relations: tuple[str, ...] = tuple(RELATIONS),
        engines: tuple[str, ...] = ("eager",),
    ) -> None:
        self.source, self.seed = Fuzz(seed), seed
        self.relations, self.engines = relations, engines
        self.rows: list[Row] = []
        self.failures: list[tuple[Row | tuple, str]] = []
        self.refused, self.covered, self.tried = (collections.Counter() for _ in range(3))
        self.pairs = collections.Counter()

    def _next(self) -> tuple[Spec, str, list[str]]:
        answer = min(ANSWERS, key=lambda n: self.tried[n])
        self.tried[answer] += 1
        spec = self.source._spec(ANSWERS[answer].way)
        draw = torch.Generator().manual_seed(spec.seed)
        if torch.rand((), generator=draw) < 0.4 and not answer.startswith(
            ("minimal", "block_rate", "explicit")
        ):
            spec = replace(spec, order=2, count=max(1, spec.count - 1))
        if answer in ("minimal", "block_rate", "explicit stepper"):
            spec = replace(spec, initial="rest")
        relations = sorted(
            self.relations, key=lambda r: self.pairs[answer, r] + self.covered[r] / 4
        )
        return spec, answer, relations

    def run(
        self, cases: int, each: int = 3, seconds: float = float("inf"), report: bool = False
    ) -> None:
        """So many scenes, some relations of each; of every third the derivatives."""
        begin, done = time.process_time(), 0
        while done < cases and time.process_time() - begin < seconds:
            spec, answer, relations = self._next()
            of, by = said(spec, answer, done % 3 == 0), self.engines[done % len(self.engines)]
            held, done = 0, done + 1
            if self._tried(lambda of=of: of.plain, (spec, answer, "plain", by), by) is None:
                continue
            for relation in relations[: 4 * each]:
                self.pairs[answer, relation] += 1
                row = self._tried(
                    lambda of=of, r=relation, by=by: compare(of, r, by),
                    (spec, answer, relation, by),
                    by,
                )
                if row is not None:
                    self._take(row, report)
                    held += 1
                if held >= each:
                    break

    def _tried(self, function, label: tuple, by: str):
        """What a function gives; None where that is refused, has no solution or fails, which is
        noted.
        """
        try:
            with warnings.catch_warnings(), engine(by):
                warnings.simplefilter("ignore")
                return function()
        except NotHere:
            return None
        except Exception as error:
            if is_refusal(error):
                self.refused[str(error)] += 1
            elif isinstance(error, Unsolved) or any(
                sentence in str(error) for sentence in NO_SOLUTION
            ):
                self.refused["(no solution)"] += 1
            else:
                places = [
                    f"{Path(f.filename).name}:{f.lineno}"
                    for f in traceback.extract_tb(error.__traceback__)
                ]
                self._failed(label, f"{type(error).__name__} at {places[-3:]}: {str(error)[:300]}")
            return None

    def _take(self, row: Row, report: bool) -> None:
        self.rows.append(row)
        self.covered.update([row.relation, row.answer, *row.spec.names])
        self.source.covered.update([*row.spec.names, row.spec.space, row.spec.initial])
        self.source.queue = [entry for entry in self.source.queue if entry not in row.spec.names]
        if report:
            print(
                f"{row.value:.1e} {row.gradient:.1e} {row.answer} / {row.relation} "
                f"[{row.engine}] {row.where}",
                flush=True,
            )
        if not row.passed:
            self._failed(row, f"{row.value:.2e} {row.gradient:.2e} {row.where}")

    def _failed(self, row: Row | tuple, what: str) -> None:
        self.failures.append((row, what))
        print("FAILED", *row[1:4], ":", what, "\n   ", row[0], flush=True)

    def save(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(
                ("seed", "answer", "relation", "engine", "values", "gradients", "where", "passed")
            )
            table.writerows((r.spec.seed, *r[1:], r.passed) for r in self.rows)
