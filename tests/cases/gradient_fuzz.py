"""Random scenes for the gradient fuzz, which goes round all ingredients, and for whatever else
wants many different scenes.
"""

import collections
import csv
import time
import traceback
from pathlib import Path

import torch

from tests.cases.gradient_cases import INITIAL, SPACES, WAYS, Case, Row, Spec, Unsolved, is_refusal
from tests.cases.gradient_ingredients import VARIANTS

LOADS = ("TipLoad", "PointLoad", "LineLoad", "Gravity.g", "History")
NO_SOLUTION = ("found no equilibrium", "the step shrank to nothing")
DAMPINGS = ("Damping", "rayleigh")  # of which a scene has one
TRIES = 4  # of an ingredient in company; after them it comes alone
COLUMNS = (
    "case", "way", "space", "start", "elements", "ingredients", "tensor", "reverse", "forward",
    "difference", "noise", "relative error", "resolved", "passed",
)  # fmt: skip


LAGGED = "StripAir lags", "StripAir gust", "StripAir stall"
MIXED = ("minimal", "block_rate", "explicit stepper")
UNMIXED = (
    "Actuation", "PointMass", "Load node", "Load inputs node", "Load internal", "RootSpring",
    "Contact", "Tendon", "Drag added_mass", *LAGGED,
)  # fmt: skip


def fits(way: str, kind: str, name: str) -> bool:
    """Whether a way to solve takes an ingredient by itself: what is surely refused would cost
    cases.
    """
    held = kind == "supports" and not name.startswith("clamp")
    moved = kind in ("frame", "root") or (
        kind == "supports" and ("displaced" in name or "turned" in name)
    )
    if way.startswith("generalized_alpha"):
        return kind != "frame" and not name.startswith(
            ("Load internal", *LAGGED, "PointMass offset", "shifted", "6x6")
        )
    if way == "midpoint conserve":
        return not moved
    if way in MIXED and (held or name.startswith(UNMIXED)):
        return False
    if way == "nodal rk4" and name.startswith("Tendon"):
        return False
    if way in (*MIXED, "nodal rk4") and (
        name in ("rigid", "without rotary inertia") or (held and moved)
    ):
        return False
    if way in MIXED and name == "linked":
        return False
    return not (way == "block_rate" and name.startswith(("Damping", "rayleigh")))


class Fuzz:
    """A run of random cases that goes round all ingredients: first each argument in one form, then
    the other forms.

    crowded   as many ingredients in a case as go together, so that few cases have all, and
              derivatives by what takes no batch (times) in every fifth alone, explicit forms short;
              else two to four ingredients
    rows      (Spec, Row) of each derivative;  failures  (Spec, sentence)
    refused   sentence -> how often;  unsolved  how many cases had no solution
    covered   how often a case ran with each ingredient, way, space and start
    """

    def __init__(self, seed: int, crowded: bool = False) -> None:
        self.crowded = crowded
        self.random = torch.Generator().manual_seed(seed)
        self.seed, self.tried, self.cases, self.unsolved = seed, 0, 0, 0
        self.rows: list[tuple[Spec, Row]] = []
        self.failures: list[tuple[Spec, str]] = []
        self.refused, self.covered, self.attempts = (collections.Counter() for _ in range(3))
        self.queue: list[tuple[str, str]] = []

    def _pick(self, *options):
        return options[int(torch.randint(len(options), (), generator=self.random))]

    def _shuffled(self, options: list) -> list:
        return [options[i] for i in torch.randperm(len(options), generator=self.random).tolist()]

    def _fill(self) -> None:
        forms = [self._shuffled(forms) for forms in VARIANTS.values()]
        self.queue = self._shuffled([f[0] for f in forms]) + self._shuffled(
            [x for f in forms for x in f[1:]]
        )

    def _spec(self, way: str | None = None) -> Spec:
        """The first ingredient in the queue that fits how the case is solved, with others of the
        queue beside it.
        """
        if not self.queue:
            self._fill()
        self.tried += 1
        way, space, start = (
            min(
                names,
                key=lambda n: self.covered[n] / (4 if n == "3D" else 1) + self.attempts[n] / 4,
            )
            for names in ((way,) if way else WAYS, SPACES, INITIAL)
        )
        self.attempts.update((way, space, start))
        space = "3D" if way in MIXED and space == "small" else space  # (whose rotations are large)
        fitting = [x for x in self.queue if fits(way, *x)] or self.queue
        if self.crowded:  # first what is missing, then other forms of what ran
            missing = {form for argument in self.missing() for form in VARIANTS.get(argument, ())}
            fitting = sorted(fitting, key=lambda x: x not in missing)
        must = min(fitting, key=lambda x: (self.crowded and x not in missing, self.attempts[x]))
        self.attempts[must] += 1
        single = {} if must[0] == "effect" else {must[0]: must}
        effects = [must] if must[0] == "effect" else []
        wanted = self._pick(*((5, 6, 7) if self.crowded else (2, 3, 4)))
        for kind, name in fitting if self.attempts[must] < TRIES else ():
            if kind == "effect":
                second = name.startswith(DAMPINGS) and any(
                    other.startswith(DAMPINGS) for _, other in effects
                )
                if len(effects) < wanted and (kind, name) != must and not second:
                    effects.append((kind, name))
            elif kind not in single and (
                kind in ("section", "beam") or self.crowded or self._pick(True, False, False)
            ):
                single[kind] = (kind, name)
        elastic = any(name.startswith("RootSpring") for _, name in effects)
        if "supports" in single and must[0] != "supports" and (elastic or "root" in single):
            del single["supports"]
        elif "supports" in single:
            single.pop("root", None)
            effects = [e for e in effects if not e[1].startswith("RootSpring")]
        single = {"section": ("section", "from_stiffness"), "beam": ("beam", "straight"), **single}
        if not any(name.startswith(LOADS) for _, name in effects):
            effects.append(("effect", "TipLoad.force value"))
        return Spec(
            self.seed * 100_000 + self.tried, way, space, (*single.values(), *effects), start,
            self._pick(2, 2, 3), self.crowded,
        )  # fmt: skip

    def run(self, cases: int, seconds: float = float("inf")) -> None:
        """So many, and more until nothing is missing; of CPU seconds at most so many."""
        end = time.process_time() + seconds
        while (self.cases < cases or self.missing()) and self.tried < 20 * cases:
            if time.process_time() > end:
                break
            spec = self._spec()
            if self.one(spec):
                self.queue = [entry for entry in self.queue if entry not in spec.names]

    def one(self, spec: Spec) -> bool:
        """Whether the case ran."""
        try:
            found = Case(spec).rows(
                one_by_one=spec.seed % 8 == 0, unbatched=not self.crowded or spec.seed % 5 == 0
            )
        except Exception as error:
            if is_refusal(error):
                self.refused[str(error)] += 1
                return False
            if isinstance(error, Unsolved) or any(
                sentence in str(error) for sentence in NO_SOLUTION
            ):
                self.unsolved += 1
                return False
            places = [
                f"{Path(f.filename).name}:{f.lineno}"
                for f in traceback.extract_tb(error.__traceback__)
                if "/torchbeam/" in f.filename
            ]
            self._failed(spec, f"{type(error).__name__} at {places[-1:]}: {str(error)[:200]}")
            found = []
        self.cases += 1
        for row in found:
            self.rows.append((spec, row))
            if not row.passed:
                self._failed(spec, str(row))
        self.covered.update([*spec.names, spec.way, spec.space, spec.initial])
        return True

    def _failed(self, spec: Spec, what: str) -> None:
        self.failures.append((spec, what))
        print(what, "  ", spec, flush=True)

    def missing(self) -> set:
        """What no case ran with: ways, spaces, starts, and arguments in whichever form."""
        arguments = {
            argument
            for argument, forms in VARIANTS.items()
            if not any(self.covered[f] for f in forms)
        }
        return arguments | {x for x in (*WAYS, *SPACES, *INITIAL) if not self.covered[x]}

    def report(self) -> str:
        errors = sorted((r.error / r.size for _, r in self.rows if r.resolved), reverse=True)
        forms = [f for forms in VARIANTS.values() for f in forms]
        return (
            f"{self.cases} cases with {sum(self.covered[f] > 0 for f in forms)} of {len(forms)} "
            f"ingredients ({sum(self.refused.values())} more refused in {len(self.refused)} "
            f"sentences, {self.unsolved} without solution): {len(self.rows)} derivatives, "
            f"{len(errors)} of them told by differences to 1e-3 or better, {len(self.failures)} "
            f"failures; largest relative distance {errors[0] if errors else 0.0:.2g}, median "
            f"{errors[len(errors) // 2] if errors else 0.0:.2g}"
        )

    def save(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(COLUMNS)
            for s, r in self.rows:
                table.writerow(
                    [
                        s.seed,
                        s.way,
                        s.space,
                        s.initial,
                        s.count,
                        "; ".join(name for _, name in s.names),
                        *r,
                        r.error / r.size if r.size else 0.0,
                        r.resolved,
                        r.passed,
                    ]
                )
