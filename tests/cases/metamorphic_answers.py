"""What is asked of a random scene: a `Problem`, and answers to it, each number with its
`Quantity`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch._C._functorch import is_batchedtensor

import torchbeam as tb
from tests.cases.gradient_cases import EXPLICIT, UNSTABLE, Case, Unsolved, exact
from tests.cases.metamorphic_parts import NotHere
from tests.cases.metamorphic_similarity import (
    ENERGY,
    INSTANT,
    ONE,
    PLACE,
    VELOCITY,
    Quantity,
    Similarity,
    input_quantities,
    quantities,
)
from torchbeam.extend import quaternions as quat

READ = ("position", "rotation", "velocity", "spin", "stress", "reaction", "work", "internal")
Found = dict[str, tuple[Quantity, Tensor]]


@dataclass(frozen=True)
class Problem:
    """parts of a scene by name; instants t (time,) of a motion, or () of what stands; inputs by
    name; where it starts (None = at rest); the longest step and what is a second here, s.
    """

    parts: dict[str, Any]
    t: Tensor
    inputs: dict[str, Any]
    start: tb.State | None = None
    step: float = 0.06
    second: float = 1.0

    @classmethod
    def of(cls, case: Case, x: dict[str, Tensor]) -> Problem:
        parts, t, inputs = case.parts(x), case.t(x), case.inputs(x)
        first = t if t.ndim == 0 else t[0]
        start = (
            None
            if case.spec.way in ("equilibrium", *EXPLICIT[2:])
            else case.start(tb.Scene(**parts), x, first, inputs)
        )
        return cls(parts, t, inputs, start)

    @cached_property
    def scene(self) -> tb.Scene:
        return tb.Scene(**self.parts)

    def turned(self, s: Similarity) -> Problem:
        """The same, told there."""
        parts, moving = self.parts, input_quantities(self.parts["effects"])
        one = {
            name: None if parts[name] is None else s(parts[name])
            for name in ("beam", "frame", "root")
        }
        supports = None if parts["supports"] is None else tuple(map(s, parts["supports"]))
        inputs = {name: s.given(moving[name], value) for name, value in self.inputs.items()}
        return Problem(
            {**parts, **one, "supports": supports, "effects": tuple(map(s, parts["effects"]))},
            s.value(INSTANT, self.t), inputs, None if self.start is None else s(self.start),
            self.step * s.time, self.second * s.time,
        )  # fmt: skip


def solved(of: tb.State | tb.Solution, velocity: Tensor) -> None:
    """Raises Unsolved where a sample has failed or flies apart; under vmap nobody can know."""
    if not is_batchedtensor(of.status) and (
        of.status.any() or not velocity.abs().amax() < 1e6 * UNSTABLE
    ):
        raise Unsolved


def states(label: str, state: tb.State) -> Found:
    solved(state, state.velocity)
    kinds = quantities(state)
    return {
        f"{label} {name}": (kinds[name], value)
        for name in READ
        if (value := getattr(state, name)) is not None
    }


def energies(solution: tb.Solution) -> Found:
    return {
        f"energy {name}": (ENERGY, e)
        for name, e in solution.energy._asdict().items()
        if e is not None
    }


def motion(p: Problem, method: str, form: str = "nodal", **options: Any) -> Found:
    with_step = {} if "rtol" in options or method == "rk4" else dict(step=p.step)
    tolerance = {} if method == "rk4" else exact()
    solution = tb.simulate(
        p.scene, p.t, p.start, method, form=form, inputs=p.inputs, **with_step, **tolerance,
        **options,
    )  # fmt: skip
    if form != "nodal":
        solved(solution, solution.tip.velocity)
        found = {
            "nodes": (PLACE, solution.nodes[1:]),
            "tip velocity": (VELOCITY, solution.tip.velocity[1:]),
        }
        return found | energies(solution)
    return states("motion", solution.state[1:]) | energies(solution)


def sensors(p: Problem, method: str = "midpoint") -> Found:
    """Readings at the instants and between them."""
    s = tb.sensors
    solution = tb.simulate(p.scene, p.t, p.start, method, inputs=p.inputs, step=p.step, **exact())
    solved(solution, solution.tip.velocity)
    strain = Quantity(kind="own polar")
    every = [(s.RootReaction(), Quantity(kind="wrench"))] if p.scene.supports else []
    every += [
        (s.TipPosition(), PLACE),
        (s.NodeVelocity(1), VELOCITY),
        (s.Spin(-1), Quantity(0, 0, -1, "own axial")),
    ]
    if p.scene.beam.order == 1:
        beam = p.scene
        every += [
            (s.Strain(element=0, beam=beam), strain),
            (s.Curvature(element=-1, beam=beam), Quantity(0, -1, 0, "own axial")),
            (s.Stress(0.4 * p.scene.beam.length.sum(-1), beam=beam), Quantity(kind="own wrench")),
        ]
    t = p.t.detach()
    times = torch.stack((t[1], 0.3 * t[0] + 0.7 * t[1], t[-1]))
    found = {}
    for sensor, q in every:
        try:
            found[f"read {sensor.name}"] = q, sensor(solution.state[1:])
            found[f"observed {sensor.name}"] = q, tb.observe(solution, sensor, times)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{type(sensor).__name__}: {error}") from error
    return found


def stepper(p: Problem, method: str) -> Found:
    step = tb.Stepper(p.scene, p.step, method, **exact())
    state, found = tb.rest(p.scene, t=p.t[0]) if p.start is None else p.start, []
    for dt, t in zip(p.t.diff(), p.t[:-1], strict=True):
        held = {name: v(t) if callable(v) else v for name, v in p.inputs.items()}
        state = step(state, dt=dt, inputs=held)
        found.append(state)
    return states("first", found[0]) | states("last", found[-1])


def rollout(p: Problem, method: str = "midpoint") -> Found:
    step = tb.Stepper(p.scene, p.step, method, **exact())
    state = tb.rest(p.scene, t=p.t[0]) if p.start is None else p.start
    return states("rollout", tb.rollout(step, state, 3, inputs=p.inputs))


def explicit_stepper(p: Problem) -> Found:
    step = tb.ExplicitStepper(p.scene, 0.004 * p.second)
    state = step(step.rest(), inputs=_held(p))
    solved(state, state.tip.velocity)
    return {"nodes": (PLACE, state.position), "tip velocity": (VELOCITY, state.tip.velocity)}


def _held(p: Problem) -> dict[str, Any]:
    t = p.t if p.t.ndim == 0 else p.t[0]
    return {name: v(t) if callable(v) else v for name, v in p.inputs.items()}


def equilibrium(p: Problem) -> Found:
    return states("equilibrium", tb.equilibrium(p.scene, t=p.t, inputs=_held(p), **exact()))


def path(p: Problem) -> Found:
    found = tb.path(p.scene, t=float(p.t), step=0.25, steps=60, inputs=_held(p), **exact())
    if found.state.status.any() or not found.reached.all():
        raise Unsolved
    return {"factor": (ONE, found.factor)} | states("path", found.state)


def modes(p: Problem) -> Found:
    found = tb.modes(p.scene, t=float(p.t), count=4, inputs=_held(p))
    rates = p.second * found.eigenvalue
    return {"frequency": (ONE, rates.imag.abs()), "growth": (ONE, rates.real)}


def critical_load(p: Problem) -> Found:
    """By all inputs at once, along them or against them: the one of the two that buckles."""
    held = _held(p)
    if not held:
        raise NotHere
    for sign in (1.0, -1.0):
        given = {name: sign * value for name, value in held.items()}
        found = tb.critical_load(p.scene, 40.0, points=9, t=float(p.t), inputs=given)
        if torch.isfinite(found.factor).all():
            return {"factor": (ONE, found.factor)}
    raise Unsolved


def linearize(p: Problem) -> Found:
    """The answer of the tip at s = 1 per second to what the inputs are, and the resolvent's
    trace.
    """
    held = _held(p)
    model = tb.linearize(p.scene, None, tb.sensors.TipPosition(), t=float(p.t), inputs=held)
    A = p.second * model.A
    eye = torch.eye(A.shape[-1])
    resolvent = torch.linalg.inv(eye - A)
    found = {
        "trace": (ONE, resolvent.diagonal(dim1=-2, dim2=-1).sum(-1)),
        "reading": (PLACE, model.output),
    }
    if held:
        u = torch.cat(torch.broadcast_tensors(*(held[name] for name in model.inputs)), -1)[
            ..., None
        ]
        gain = p.second * model.C @ resolvent @ model.B @ u + model.D @ u
        found["gain"] = Quantity(0, 1, 0, "polar"), gain[..., 0]
    return found


class Answer(NamedTuple):
    """The way of `Case` by whose times and starts it goes; problem -> found; whether it takes
    batches, and has gradients.
    """

    way: str
    function: Callable[[Problem], Found]
    batched: bool = True
    gradient: bool = True


ANSWERS = {
    "midpoint": Answer("midpoint", partial(motion, method="midpoint")),
    "midpoint checkpoint": Answer("midpoint", partial(motion, method="midpoint", checkpoint=True)),
    "midpoint lumped": Answer("midpoint", partial(motion, method="midpoint", lumped=True)),
    "midpoint conserve": Answer(
        "midpoint conserve", partial(motion, method="midpoint", conserve=True)
    ),
    "midpoint4": Answer("midpoint", partial(motion, method="midpoint4")),
    "generalized_alpha": Answer("generalized_alpha", partial(motion, method="generalized_alpha")),
    "generalized_alpha rho": Answer(
        "generalized_alpha", partial(motion, method="generalized_alpha", rho_inf=0.3)
    ),
    "rtol": Answer("midpoint", partial(motion, method="midpoint", rtol=1e-4)),
    "rtol midpoint4": Answer("midpoint", partial(motion, method="midpoint4", rtol=1e-4)),
    "sensors": Answer("midpoint", sensors),
    "stepper midpoint": Answer("midpoint", partial(stepper, method="midpoint")),
    "stepper midpoint4": Answer("midpoint", partial(stepper, method="midpoint4")),
    "stepper generalized_alpha": Answer(
        "generalized_alpha", partial(stepper, method="generalized_alpha")
    ),
    "rollout": Answer("midpoint", rollout),
    "nodal rk4": Answer("nodal rk4", partial(motion, method="rk4")),
    "explicit stepper": Answer("explicit stepper", explicit_stepper),
    "minimal": Answer("minimal", partial(motion, method="rk4", form="minimal")),
    "block_rate": Answer("block_rate", partial(motion, method="rk4", form="block_rate")),
    "equilibrium": Answer("equilibrium", equilibrium),
    "path": Answer("equilibrium", path, gradient=False),
    "modes": Answer("equilibrium", modes),
    "linearize": Answer("equilibrium", linearize),
    "critical_load": Answer("equilibrium", critical_load),
}


def told(found: Found, by: Similarity | None = None) -> dict[str, Tensor]:
    """Numbers as they are told by a similarity; rotations as matrices, of which each has one."""
    values = {name: (q, x if by is None else by.value(q, x)) for name, (q, x) in found.items()}
    return {
        name: quat.matrix(x) if q.kind in ("rotation", "frame") else x
        for name, (q, x) in values.items()
    }
