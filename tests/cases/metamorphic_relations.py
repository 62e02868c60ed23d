"""Relations: two ways to say one thing, each a function of a `Said` that gives what comes of both."""

from __future__ import annotations

import copy
import io
import os
import random
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial

import torch
from gradient_cases import Case, Spec, Unsolved
from gradient_ingredients import POLAR
from metamorphic_answers import ANSWERS, EXACT, Found, Problem, energies, states, told
from metamorphic_similarity import Similarity, input_quantities
from metamorphic_words import HOLDERS, WORDS, NotHere, numbered
from torch import Tensor

import torchbeam as tb
from torchbeam.math import quaternions as quat

Blocks = dict[str, Tensor]
Pair = tuple[Blocks, Blocks]
SAMPLES = 4  # no other axis is as long
MOTIONS = ("midpoint", "midpoint lumped", "midpoint conserve", "midpoint4", "generalized_alpha")  # by `simulate` in steps
BY_STEPS = {"midpoint": "stepper midpoint", "midpoint4": "stepper midpoint4", "generalized_alpha": "stepper generalized_alpha"}


@contextmanager
def engine(name: str) -> Iterator[None]:
    before = os.environ.get("TORCHBEAM_ENGINE")
    os.environ["TORCHBEAM_ENGINE"] = name
    try:
        yield
    finally:
        os.environ["TORCHBEAM_ENGINE"] = before or "auto"


@dataclass
class Said:
    """A random scene and what is asked of it; x: the tensors that it is made of; seed: of what a relation draws."""

    spec: Spec
    answer: str
    x: Blocks
    case: Case
    seed: int = 0

    @property
    def random(self) -> random.Random:
        return random.Random(self.spec.seed * 31 + self.seed)

    @cached_property
    def problem(self) -> Problem:
        return Problem.of(self.case, self.x)

    def ask(self, problem: Problem | None = None, answer: str | None = None) -> Found:
        return ANSWERS[answer or self.answer].function(problem or self.problem)

    @cached_property
    def plain(self) -> Blocks:
        return told(self.ask())

    def of(self, x: Blocks) -> Blocks:
        return told(self.ask(Problem.of(self.case, x)))

    def several(self, samples: int = SAMPLES) -> tuple[Blocks, list[Blocks]]:
        """Tensors of several scenes in one batch, but for those that take none; and one by one."""
        scale = 1 + 0.01 * torch.arange(samples)
        batch = {n: v if n in self.case.draw.alone else v * scale[(...,) + (None,) * v.ndim] for n, v in self.x.items()}
        return batch, [{n: v if n in self.case.draw.alone else v * k for n, v in self.x.items()} for k in scale]


def _words(change: Callable, said: Said) -> Pair:
    p = said.problem
    start = p.start
    parts = change(p.parts)
    return said.plain, told(said.ask(replace(p, parts=parts, start=start)))


def _turn(said: Said, mirror: bool = False) -> Tensor:
    """A random rotation that the scene can take: of axes to axes where supports hold some of these, in its plane where it has
    one.
    """
    p, draw = said.problem, said.random
    supports = p.parts["supports"] or ()
    plane = said.case.plane
    partial_ = any(len(s.position) in (1, 2) or len(s.rotation) == 2 for s in supports)
    if plane is not None:
        a, b = POLAR[plane]
        angle = draw.choice((1, 2, 3)) * torch.pi / 2 if partial_ else draw.uniform(-3.0, 3.0)
        c, s = torch.cos(torch.tensor(angle)), torch.sin(torch.tensor(angle))
        c, s = (c.round(), s.round()) if partial_ else (c, s)
        Q = torch.eye(3)
        Q[a, a], Q[a, b], Q[b, a], Q[b, b] = c, -s, s, c
        if mirror:
            Q = Q * torch.where(torch.arange(3) == draw.choice((0, 1, 2)), -1.0, 1.0)
        return Q
    if partial_:
        Q = torch.eye(3)[draw.sample(range(3), 3)] * torch.tensor([draw.choice((-1.0, 1.0)) for _ in range(3)])
    else:
        Q = quat.matrix(quat.normalize(torch.tensor([draw.gauss(0, 1) for _ in range(4)])))
    return Q if (torch.linalg.det(Q) < 0) == mirror else -Q


def _similar(make: Callable[[Said], Similarity], said: Said) -> Pair:
    s = make(said)
    return said.plain, told(said.ask(said.problem.turned(s)), s.inverse)


def _moved(said: Said) -> Similarity:
    if said.problem.parts["frame"] is not None:
        raise NotHere  # its own motion is told about its origin
    inside = torch.tensor([1.0, 1, 1] if said.case.plane is None else [float(i in POLAR[said.case.plane]) for i in range(3)])
    return Similarity(origin=inside * torch.tensor([said.random.uniform(-2, 2) for _ in range(3)]))


def _units(said: Said) -> Similarity:
    draw = said.random
    mass, length, time = (10 ** draw.uniform(-3.0, 3.0) for _ in range(3))
    return Similarity(mass=mass, length=length, time=time)


def _later(said: Said) -> Similarity:
    frame = said.problem.parts["frame"]
    if frame is not None and frame.angular_velocity is not None:
        raise NotHere  # its axes are the inertial ones at t = 0
    return Similarity(shift=said.random.uniform(0.5, 2.0))


def batch(said: Said) -> Pair:
    """Several at once, and one by one."""
    _wants(said, ANSWERS[said.answer].batched and not said.case.draw.alone - {"times", "t"})
    together, alone = said.several()
    whole, each = said.of(together), [said.of(x) for x in alone]
    if said.answer == "path":  # each sample goes at its own pace
        whole, each = {n: v[-1] for n, v in whole.items()}, [{n: v[-1] for n, v in x.items()} for x in each]
    return whole, _stacked(each, whole)


def _stacked(few: list[Blocks], like: Blocks) -> Blocks:
    """Samples one by one with the axis of the samples where the batch has it."""
    found = {}
    for name, value in like.items():
        one = few[0][name]
        axis = next((i for i in range(value.ndim) if value.shape[:i] == one.shape[:i] and value.shape[i] == len(few)
                     and value.shape[i + 1:] == one.shape[i:]), None)
        found[name] = value if axis is None else torch.stack([x[name] for x in few], axis)
        if axis is None:  # nothing in it differs from sample to sample
            found[name] = one.expand_as(value)
    return found


def axes(said: Said) -> Pair:
    """Batch axes (2, 1) and (1, 2) of different tensors, and both on all."""
    _wants(said, ANSWERS[said.answer].batched and said.answer != "path")
    wide, full = {}, {}
    for k, (n, v) in enumerate(said.x.items()):
        if n in said.case.draw.alone:
            wide[n] = full[n] = v
            continue
        scale = 1 + 0.01 * torch.arange(2.0)
        scale = scale[:, None] if k % 2 else scale[None, :]
        wide[n] = v * scale[(...,) + (None,) * v.ndim]
        full[n] = v * scale.expand(2, 2)[(...,) + (None,) * v.ndim]
    return said.of(wide), said.of(full)


def vmapped(said: Said) -> Pair:
    _wants(said, said.answer in ("midpoint", "generalized_alpha", "equilibrium", "midpoint4", "minimal", "nodal rk4"))
    together, _ = said.several()
    dims = {n: None if n in said.case.draw.alone else 0 for n in together}
    with engine("eager"):
        found = torch.func.vmap(said.of, (dims,))(together)
        plain = said.of(together)
    return {n: v.movedim(0, -1) for n, v in found.items()}, {
        n: plain[n].movedim(_axis(plain[n], found[n]), -1) for n in plain}


def _axis(value: Tensor, like: Tensor) -> int:
    return next(i for i in range(value.ndim) if value.movedim(i, 0).shape == like.shape)


def engines(said: Said) -> Pair:
    with engine("eager"):
        a = said.of(said.x)
    with engine("compiled"):
        return a, said.of(said.x)


def again(said: Said) -> Pair:
    """After a scene of the same code with other numbers."""
    with engine("eager"):
        a = said.of(said.x)
    with engine("auto"):
        said.of({n: v if n in said.case.draw.alone else 1.07 * v for n, v in said.x.items()})
        return a, said.of(said.x)


def _numbers(holder: str, said: Said) -> Pair:
    """After a scene whose functions have another number, which stands where users have their numbers."""
    p = said.problem
    a = told(said.ask(replace(p, parts=numbered(p.parts, holder, 1.0))))
    with engine("auto"):
        told(said.ask(replace(p, parts=numbered(p.parts, holder, 1.1))))
        return a | {f"{n} plain": v for n, v in said.plain.items()}, (b := told(said.ask(replace(
            p, parts=numbered(p.parts, holder, 1.0))))) | {f"{n} plain": v for n, v in b.items()}


def restart(said: Said, through: Callable = lambda state: state) -> Pair:
    _wants(said, said.answer in MOTIONS or said.answer == "nodal rk4")
    p, method = said.problem, said.answer.split()[0]
    if said.answer == "nodal rk4":
        options = dict(method="rk4", inputs=p.inputs)
    else:
        options = dict(method=method, inputs=p.inputs, step=p.step, **dict.fromkeys(said.answer.split()[1:], True), **EXACT)
    whole = tb.simulate(p.scene, p.t, p.start, **options)
    first = tb.simulate(p.scene, p.t[:2], p.start, **options)
    last = tb.simulate(p.scene, p.t[1:], through(first.state[-1]), **options)
    a, b = told(states("motion", whole.state[2:])), told(states("motion", last.state[1:]))
    return a | {"motion work": a["motion work"] - whole.state[1].work}, b


def _saved(state: tb.State) -> tb.State:
    file = io.BytesIO()
    torch.save(state.detach(), file)
    file.seek(0)
    return torch.load(file, weights_only=False)


def _solved(said: Said, t=None, **changed) -> Found:
    p, answer = said.problem, said.answer
    method, *more = answer.split()
    options = dict(initial=p.start, method=method, inputs=p.inputs, step=p.step, **dict.fromkeys(more, True), **EXACT) | changed
    solution = tb.simulate(p.scene, p.t if t is None else t, **options)
    return states("motion", solution.state[1:]) | energies(solution)


def _way(said: Said, make: Callable[[Said], dict]) -> Pair:
    _wants(said, said.answer in MOTIONS)
    return said.plain, told(_solved(said, **make(said)))


def by_list(said: Said) -> dict:
    return dict(t=said.problem.t.tolist())


def with_checkpoint(said: Said) -> dict:
    return dict(checkpoint=True)


def by_keyword(said: Said) -> dict:
    _wants(said, bool(said.problem.inputs) and all(name.isidentifier() for name in said.problem.inputs))
    return dict(inputs=None, **said.problem.inputs)


def by_functions(said: Said) -> dict:
    inputs = said.problem.inputs
    _wants(said, bool(inputs) and not any(map(callable, inputs.values())))
    return dict(inputs={n: lambda t, v=v: v for n, v in inputs.items()})


def by_intervals(said: Said) -> dict:
    inputs, K = said.problem.inputs, len(said.problem.t) - 1
    _wants(said, bool(inputs) and not any(map(callable, inputs.values())))
    return dict(inputs={n: tb.PerInterval(v[..., None, :].expand(*v.shape[:-1], K, v.shape[-1])) for n, v in inputs.items()})


def two_threads(said: Said) -> dict:
    return {}


def finer(said: Said) -> Pair:
    """Outputs in the middle of equal steps, and without."""
    _wants(said, said.answer in MOTIONS)
    t, p = said.problem.t, said.problem
    _wants(said, not any(isinstance(v, tb.PerInterval) for v in p.inputs.values()))
    fine = torch.stack((t[0], (t[0] + t[1]) / 2, t[1]))
    step = float((t[1] - t[0]) / 2)
    a, b = _solved(said, t=t[:2], step=step), _solved(said, t=fine, step=step)
    return told(a), {n: v[-1:] if n.startswith("motion") else v for n, v in told(
        {n: (q, v) for n, (q, v) in b.items()}).items() if n.startswith("motion")} | {
        n: v[[0, -1]] for n, v in told(b).items() if not n.startswith("motion")}


def threads(said: Said) -> Pair:
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        b = said.of(said.x)
    finally:
        torch.set_num_threads(before)
    return said.plain, b


def by_steps(said: Said) -> Pair:
    """`simulate` and `Stepper`, inputs held."""
    _wants(said, said.answer in BY_STEPS and not any(map(callable, said.problem.inputs.values())))
    b = told(said.ask(answer=BY_STEPS[said.answer]))
    last = {name.removeprefix("last "): v for name, v in b.items() if name.startswith("last")}
    return {n: said.plain[f"motion {n}"][-1] for n in last}, last


def by_rollout(said: Said) -> Pair:
    """`rollout`, and `Stepper` step by step; its step is a number."""
    _wants(said, said.answer == "rollout" and not any(map(callable, said.problem.inputs.values())))
    p = said.problem
    step, found = tb.Stepper(p.scene, p.step, **EXACT), []
    state = tb.rest(p.scene, t=p.t[0]) if p.start is None else p.start
    for _ in range(3):
        found.append(step(state := found[-1] if found else state, inputs=p.inputs))
    each = [told(states("rollout", s)) for s in found]
    return said.plain, {n: torch.stack([e[n].expand(said.plain[n].shape[1:]) for e in each]) for n in said.plain}


def dual(said: Said) -> Pair:
    """<v, J u> = <J^T v, u>"""
    _wants(said, ANSWERS[said.answer].gradient and any(v.requires_grad for v in said.x.values()))
    draw = torch.Generator().manual_seed(said.spec.seed)
    u = {n: 0.1 * said.case.draw.size[n] * torch.randn(v.shape, generator=draw) for n, v in said.x.items()}
    v = None

    def of(x: Blocks) -> Tensor:
        nonlocal v
        blocks = said.of(x)
        if v is None:
            v = {n: torch.randn(b.shape, generator=draw) / b.detach().abs().max().clamp(min=1e-3) if b.numel() else b.detach()
                 for n, b in blocks.items()}
        return sum((v[n] * b).sum() for n, b in blocks.items())
    y = of(said.x)
    slopes = torch.autograd.grad(y, list(said.x.values()), allow_unused=True)
    back = sum((g * u[n]).sum() for (n, _), g in zip(said.x.items(), slopes, strict=True) if g is not None)
    forward = _jvp(of, said.x, u)
    size = sum((g * u[n]).abs().sum() for (n, _), g in zip(said.x.items(), slopes, strict=True) if g is not None)
    return {"product": (back / size).detach()[None]}, {"product": (forward / size)[None]}


def _jvp(of: Callable, x: Blocks, u: Blocks) -> Tensor:
    import torch.autograd.forward_ad as forward_ad
    with forward_ad.dual_level():
        y = forward_ad.unpack_dual(of({n: forward_ad.make_dual(v.detach(), u[n]) for n, v in x.items()}))
        return torch.zeros_like(y.primal) if y.tangent is None else y.tangent


def _wants(said: Said, holds: bool) -> None:
    if not holds:
        raise NotHere


RELATIONS: dict[str, Callable[[Said], Pair]] = {
    "turned": partial(_similar, lambda said: Similarity(turn=_turn(said))),
    "mirrored": partial(_similar, lambda said: Similarity(turn=_turn(said, True))),
    "moved": partial(_similar, _moved),
    "units": partial(_similar, _units),
    "later": partial(_similar, _later),
    **{f"words: {name}": partial(_words, change) for name, change in WORDS.items()},
    "batch": batch, "axes": axes, "vmap": vmapped, "engines": engines, "again": again,
    **{f"numbers: {holder}": partial(_numbers, holder) for holder in HOLDERS},
    "restart": restart, "restart from a file": partial(restart, through=_saved),
    "restart from a clone": partial(restart, through=lambda s: copy.deepcopy(s.detach()) if not s.position.requires_grad else s.clone()),
    "t as a list": partial(_way, make=by_list), "checkpoint": partial(_way, make=with_checkpoint),
    "inputs by keyword": partial(_way, make=by_keyword), "inputs as functions": partial(_way, make=by_functions),
    "inputs per interval": partial(_way, make=by_intervals),
    "finer outputs": finer, "threads": threads, "by steps": by_steps, "by rollout": by_rollout, "dual": dual,
}
VALUES_ONLY = {"t as a list", "restart from a file", "dual", "vmap"}  # relations that lose derivatives, or are about them
__all__ = ["RELATIONS", "VALUES_ONLY", "NotHere", "Said", "Unsolved", "engine", "input_quantities", "warnings"]
