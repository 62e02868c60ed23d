"""Cases of the gradient fuzz: a random scene, how it is solved, and the derivatives of what comes
of it by every tensor in it, by reverse mode, by forward mode and by differences.
"""

import traceback
import warnings
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import torch
import torch.autograd.forward_ad as forward_ad
from torch import Tensor

import torchbeam as tb
from tests.cases import (
    gradient_effects,  # noqa: F401  (these three fill the table)
    gradient_geometry,  # noqa: F401
    gradient_motions,  # noqa: F401
)
from tests.cases.gradient_ingredients import TABLE, Draw, Tensors
from torchbeam.extend import own_leaves
from torchbeam.extend import quaternions as quat

# of the scaled residual, by the default dtype, which is the scene's: near its rounding
TIGHT = {torch.float64: 1e-12, torch.float32: 1e-6}
SMALL = 1e-3  # size of an output (m, N, J) below which it is not scaled up: its rounding would be
UNSTABLE = 1e3  # m/s: an explicit method's step was too long
STEPS = (0.02, 0.01, 0.005)  # of central differences, of a tensor's size
# of these, where they disagree: across a kink (|v| v of a drag) they do not know their own error
FINER = (1 / 16, 1 / 256)
# of a derivative, by which two ways to it may differ beside the noise of the differences
RELATIVE = 1e-5
RESOLVED = 1e-3  # of a derivative: noise above which differences say nothing about it
# of the outputs: what a tolerance of 1e-12 leaves, and accelerations (differences over dt^2) make
# of it
ROUNDING = 1e-11
# of the outputs, each of size one: no influence; accelerations of a stiff direction round at 1e-7
NONE = 1e-6

IMPLICIT = (
    "midpoint", "generalized_alpha", "midpoint checkpoint", "generalized_alpha checkpoint",
    "midpoint conserve", "midpoint lumped", "stepper midpoint", "stepper generalized_alpha",
)  # fmt: skip
EXPLICIT = ("nodal rk4", "explicit stepper", "minimal", "block_rate")
WAYS = ("equilibrium", *IMPLICIT, *EXPLICIT)
SPACES = ("3D", "xy", "xz", "auto", "small")
INITIAL = ("rest", "velocity", "spin", "position", "rotation", "equilibrium")


def exact() -> dict[str, float]:
    return dict(tolerance=TIGHT[torch.get_default_dtype()])


class Unsolved(Exception):
    """The scene has no solution that is wanted here."""


@dataclass(frozen=True)
class Spec:
    """A case, from which all of it follows: seed, how it is solved, in which space, ingredients by
    kind, elements, start; `short`: explicit forms make one step instead of two; the order of the
    elements.
    """

    seed: int
    way: str
    space: str
    names: tuple[tuple[str, str], ...]
    initial: str = "rest"
    count: int = 2
    short: bool = False
    order: int = 1


class Row(NamedTuple):
    """Derivatives of one case by one tensor in one direction; noise: of `difference`, told by the
    differences themselves.
    """

    name: str
    reverse: float
    forward: float | None
    difference: float
    noise: float

    def __str__(self) -> str:
        forward = "refused" if self.forward is None else f"{self.forward:.9g}"
        difference = f"{self.difference:.9g} +- {self.noise:.1g}"
        return (
            f"by {self.name}: reverse {self.reverse:.9g}, forward {forward}, differences "
            f"{difference}"
        )

    @property
    def size(self) -> float:
        return max(abs(self.difference), abs(self.reverse), abs(self.forward or 0.0))

    @property
    def error(self) -> float:
        """The largest distance of two of them."""
        every = [self.reverse, self.difference, *([] if self.forward is None else [self.forward])]
        return max(every) - min(every) if all(v == v for v in every) else float("inf")

    @property
    def passed(self) -> bool:
        return self.forward is not None and (
            self.size <= NONE or self.error <= RELATIVE * self.size + 3 * self.noise
        )

    @property
    def resolved(self) -> bool:
        return self.noise <= RESOLVED * self.size and self.size > NONE


@dataclass
class Case:
    """One case with its scene as a function of tensors."""

    spec: Spec
    draw: Draw = field(init=False)
    weights: dict[str, Tensor] | None = field(default=None, init=False)
    dtype: torch.dtype | None = None  # asked for of its scenes

    def __post_init__(self) -> None:
        s = self.spec
        self.plane = s.space if s.space in ("xy", "xz") else "xy" if s.space == "auto" else None
        self.draw = d = Draw(s.seed, self.plane, s.count, s.order)
        kinds: dict[str, list] = {kind: [] for kind in TABLE}
        for kind, name in s.names:
            kinds[kind].append(TABLE[kind][name](d))
        self.kinds = kinds
        self._placed()

    def _placed(self) -> None:
        """Times, inputs that move, and the initial state."""
        d, s, nodes = self.draw, self.spec, self.spec.order * self.spec.count + 1
        if s.way == "equilibrium":
            self.t = d.tensor("t", d.uniform(low=0.27, high=0.35), alone=True)
        elif "stepper" in s.way:
            self.t = d.tensor("start time", torch.tensor(0.17), size=0.1)
            self.dt = d.tensor("dt", torch.tensor(0.06), size=0.02, alone=True)
        else:
            fast = s.way in EXPLICIT
            times = torch.tensor([0.17, 0.1725, 0.1755] if fast else [0.17, 0.224, 0.277])
            self.t = d.tensor(
                "times",
                times[:2] if fast and s.short else times,
                alone=True,
                size=0.006 if fast else 0.1,
            )
        self.moving = {}
        if d.inputs and "stepper" not in s.way and s.way != "equilibrium" and d.pick(False, True):
            rate = d.number("input rate", 2.0, 5.0)
            self.moving = dict.fromkeys(d.inputs, rate)
        sizes = dict(velocity=0.3, spin=0.5, position=0.02, rotation=0.1)
        self.disturbed = None
        if s.initial in sizes:
            self.disturbed = d.vector(
                f"initial {s.initial}",
                sizes[s.initial],
                s.initial in ("spin", "rotation"),
                s.count if s.way in ("minimal", "block_rate") else nodes,
            )

    def parts(self, x: Tensors) -> dict:
        """What the scene is made of, by the names of `Scene`'s arguments."""
        made = {
            kind: [make(x) for make in readers]
            for kind, readers in self.kinds.items()
            if kind not in ("beam", "section")
        }
        effects = [
            e for some in made["effect"] for e in (some if isinstance(some, tuple) else (some,))
        ]
        plane = self.spec.space if self.spec.space in ("xy", "xz", "auto") else None
        return dict(
            beam=self.kinds["beam"][0](x, self.kinds["section"][0](x)), effects=tuple(effects),
            **{name: next(iter(made[name]), None) for name in ("frame", "root", "supports")},
            small=self.spec.space == "small", plane=plane, dtype=self.dtype,
        )  # fmt: skip

    def scene(self, x: Tensors) -> tb.Scene:
        return tb.Scene(**self.parts(x))

    def inputs(self, x: Tensors) -> dict:
        found = {name: read(x) for name, read in self.draw.inputs.items()}
        rates = {name: read(x) for name, read in self.moving.items()}
        return {
            name: v
            if name not in rates
            else lambda t, v=v, name=name: v * torch.cos(rates[name] * t)[..., None]
            for name, v in found.items()
        }

    def start(self, scene: tb.Scene, x: Tensors, t: Tensor, inputs: dict) -> tb.State | None:
        """The initial state: what no support holds of it disturbed."""
        kind = self.spec.initial
        if kind == "rest":
            return None
        if kind == "equilibrium":
            held = {name: v(t) if callable(v) else v for name, v in inputs.items()}
            return tb.equilibrium(scene, t=t, inputs=held, **exact())
        state, free = tb.rest(scene, t=t), torch.ones(scene.beam.station_count + 1, 1)
        free[[s.node for s in scene.supports]] = 0
        move = (free * self.disturbed(x)).to(state.position)
        if kind == "rotation":
            return replace(
                state, rotation=quat.multiply(quat.exponential(move), state.rotation)
            ).broadcast()
        return replace(state, **{kind: getattr(state, kind) + move}).broadcast()

    def mixed_start(self, scene: tb.Scene, x: Tensors, inputs: dict) -> tb.MixedState | None:
        form, kind, at = self.spec.way, self.spec.initial, self.t(x)[0]
        if kind == "rest":
            return None
        held = {name: v(at) if callable(v) else v for name, v in inputs.items()}
        name = dict(velocity="V", spin="Omega", position="u", rotation="theta", equilibrium="u")[
            kind
        ]
        move = (
            torch.full((self.spec.count, 3), 0.01) if kind == "equilibrium" else self.disturbed(x)
        )
        return tb.consistent_state(scene, form=form, t=at, inputs=held, **{name: move})

    def blocks(self, x: Tensors) -> dict[str, Tensor]:
        """What comes of the tensors: (..., n) each."""
        way, scene, inputs = self.spec.way, self.scene(x), self.inputs(x)
        if way == "equilibrium":
            state = tb.equilibrium(scene, t=self.t(x), inputs=inputs, **exact())
            return self._read("", state)
        at = self.draw.tensors["start time"] if "stepper" in way else self.t(x)[0]  # of a start
        if way == "explicit stepper":
            stepper = tb.ExplicitStepper(scene, 0.004)
            state = stepper.rest()
            for _ in range(1 if self.spec.short else 2):
                state = stepper(state, inputs=inputs)
            return self._read("", state)
        if "stepper" in way:
            method = way.split()[1]
            stepper, t = tb.Stepper(scene, 0.06, method, **exact()), self.t(x)
            state = self.start(scene, x, at, inputs)
            state = tb.rest(scene, t=at) if state is None else state
            lead = torch.broadcast_shapes(t.shape, state.t.shape)
            state = replace(
                state,
                t=t.expand(lead),
                work=state.work.expand(lead),
                status=state.status.expand(lead),
            ).broadcast()
            for _ in range(2):
                state = stepper(state, dt=self.dt(x), inputs=inputs)
            return self._read("", state)
        if way in EXPLICIT:
            form = way.split()[0]
            initial = (
                self.start(scene, x, at, inputs)
                if form == "nodal"
                else self.mixed_start(scene, x, inputs)
            )
            solution = tb.simulate(scene, self.t(x), initial, "rk4", form=form, inputs=inputs)
        else:
            method, *more = way.split()
            solution = tb.simulate(
                scene, self.t(x), self.start(scene, x, at, inputs), method, inputs=inputs,
                step=0.06, **dict.fromkeys(more, True), **exact(),
            )  # fmt: skip
        energy = {
            f"energy {n}": e[-1][..., None]
            for n, e in solution.energy._asdict().items()
            if e is not None
        }
        return (
            self._read("first ", solution.state[1])
            | self._read("last ", solution.state[-1])
            | energy
        )

    def _read(self, when: str, state) -> dict[str, Tensor]:
        if state.status.any() or not state.velocity.abs().amax() < UNSTABLE:
            raise Unsolved
        found = {}
        for _, name, value, own in own_leaves(state):
            if name not in ("status", "defect") and value is not None:
                found[when + name] = (
                    value[..., None] if own == 0 else value if own == 1 else value.flatten(-own)
                )
        return found

    def __call__(self, x: Tensors) -> Tensor:
        """One number (...) of all that comes of the tensors: blocks of size one at most, in random
        proportions.
        """
        blocks = self.blocks(x)
        if self.weights is None:
            self.weights = {}
            for name, value in blocks.items():
                size = value.detach().square().mean().sqrt()
                w = (
                    torch.randn(value.shape[-1], generator=self.draw.random)
                    if value.numel()
                    else torch.zeros(0)
                )
                self.weights[name] = w / size.clamp(min=SMALL)
        total = torch.zeros(())
        for name, value in blocks.items():
            total = total + (self.weights[name] * value).sum(-1)
        return total

    def rows(self, one_by_one: bool = False, unbatched: bool = True) -> list[Row]:
        """Derivatives by every tensor, each in a direction of its own; those that take a batch as
        one batch, the others (`unbatched`) together. Or `one_by_one`, without any batch: by all
        together, so scaled that each has a share in it.
        """
        x, d = self.draw.tensors, self.draw
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            along = {
                n: d.size[n]
                * (torch.rand(v.shape, generator=d.random) + 0.3)
                * (torch.rand(v.shape, generator=d.random) - 0.5).sign()
                for n, v in x.items()
            }
            leaves = {n: v.clone().requires_grad_() for n, v in x.items()}
            y = self(leaves)
            if y.requires_grad:
                slopes = torch.autograd.grad(y, list(leaves.values()), allow_unused=True)
            else:
                slopes = [None] * len(x)
            reverse = {
                n: 0.0 if g is None else (g * along[n]).sum().item()
                for n, g in zip(x, slopes, strict=True)
            }
            if one_by_one:
                scaled = {
                    n: v * min(1.0, 1.0 / max(abs(reverse[n]), 1e-3)) for n, v in along.items()
                }
                shares = [reverse[n] * min(1.0, 1.0 / max(abs(reverse[n]), 1e-3)) for n in x]
                forward = self._jvp(x, scaled)
                forward = None if forward is None else forward.item()
                return [
                    self._refined(
                        Row("all", sum(shares), forward, *self._one_by_one(x, scaled)), x, scaled
                    )
                ]
            names = [n for n in x if n not in d.alone]
            alone = {n: along[n] for n in x if n in d.alone}
            forward = self._forward(x, along, names)
            rows = [
                Row(n, reverse[n], f, *difference)
                for n, f, difference in zip(
                    names, forward, self._differences(x, along, names), strict=False
                )
            ]
            for part in FINER:
                if unsettled := [row for row in rows if not row.passed and row.forward is not None]:
                    differences = self._differences(x, along, [row.name for row in unsettled], part)
                    finer = dict(zip(unsettled, differences, strict=True))
                    rows = [Row(*row[:3], *finer[row]) if row in finer else row for row in rows]
            if alone and unbatched:
                total = sum(reverse[n] for n in alone)
                rows.append(
                    self._refined(
                        Row(" and ".join(alone), total, forward[-1], *self._one_by_one(x, alone)),
                        x,
                        alone,
                    )
                )
        return rows

    def _rows_of(self, x: Tensors, count: int) -> Tensors:
        return {
            m: v if m in self.draw.alone else v.expand(count, *v.shape).clone()
            for m, v in x.items()
        }

    @staticmethod
    def _one_hot(index: int, count: int, steps: Tensor, along: Tensor) -> Tensor:
        """`along` times the steps in the samples of one tensor, of `count`; none in the others."""
        hot = torch.zeros(count, len(steps))
        hot[index] = steps
        return hot.flatten()[(...,) + (None,) * along.ndim] * along

    def _forward(self, x: Tensors, along: Tensors, names: list[str]) -> list[float | None]:
        """Forward mode: a sample for each name, whose tensor alone moves there; the last for those
        that take no batch, which move in all.
        """
        n = len(names) + 1
        tangents = {
            m: along[m]
            if m not in names
            else self._one_hot(names.index(m), n, torch.ones(1), along[m])
            for m in x
        }
        found = self._jvp(self._rows_of(x, n), tangents)
        if found is None:
            return [None] * n
        found = found.expand(n)
        return [*(found[:-1] - found[-1]).tolist(), found[-1].item()]

    def _differences(
        self, x: Tensors, along: Tensors, names: list[str], part: float = 1.0
    ) -> list[tuple[float, float]]:
        """By each name, with a part of the `STEPS`; six samples for each in one batch."""
        n, h = len(names), torch.tensor([part * s * h for h in STEPS for s in (1, -1)])
        with torch.no_grad():
            moved = {
                m: v + self._one_hot(names.index(m), n, h, along[m]) if m in names else v
                for m, v in self._rows_of(x, 6 * n).items()
            }
            values = self(moved).expand(6 * n).reshape(n, 6)
        return [extrapolated(v, part) for v in values]

    def _one_by_one(self, x: Tensors, along: Tensors, part: float = 1.0) -> tuple[float, float]:
        """By all that move, one sample at a time, with a part of the `STEPS`."""
        with torch.no_grad():
            return extrapolated(
                torch.stack(
                    [
                        self({**x, **{m: x[m] + part * step * v for m, v in along.items()}})
                        for h in STEPS
                        for step in (h, -h)
                    ]
                ),
                part,
            )

    def _refined(self, row: Row, x: Tensors, along: Tensors) -> Row:
        """The row, with finer differences as long as it does not pass."""
        for part in FINER:
            if row.passed or row.forward is None:
                break
            difference, noise = self._one_by_one(x, along, part)
            row = row._replace(difference=difference, noise=noise)
        return row

    def _jvp(self, x: Tensors, tangents: Tensors) -> Tensor | None:
        """By dual numbers, and sometimes by torch.func.jvp, three times as slow. None where that is
        refused.
        """
        try:
            if self.spec.seed % 8 == 4:
                return torch.func.jvp(self, (x,), (tangents,))[1]
            with forward_ad.dual_level():
                y = forward_ad.unpack_dual(
                    self({n: forward_ad.make_dual(v, tangents[n]) for n, v in x.items()})
                )
                return torch.zeros_like(y.primal) if y.tangent is None else y.tangent
        except ValueError as error:
            if not is_refusal(error):
                raise
            return None


def is_refusal(error: Exception) -> bool:
    """Whether an error is a sentence of torchbeam's about what was given."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return (
        isinstance(error, ValueError)
        and "torchbeam" in last.filename
        and (last.line or "").startswith("raise ")
    )


def extrapolated(values: Tensor, part: float = 1.0) -> tuple[float, float]:
    """Derivative and its noise from values at +h, -h of the three `STEPS`, or a part of each:
    Romberg's table, and the distance of its last two columns with the rounding of the values.
    """
    first, second, third = (
        (values[2 * i] - values[2 * i + 1]) / (2 * h * part) for i, h in enumerate(STEPS)
    )
    better, best = (4 * second - first) / 3, (4 * third - second) / 3
    found = best + (best - better) / 15
    rounding = ROUNDING * values.abs().max() / (STEPS[-1] * part)
    return found.item(), ((found - best).abs() + rounding).item()
