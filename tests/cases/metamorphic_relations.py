"""Relations: two ways to say one thing, each a function of a `Said` that gives what comes of
both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import torch
from torch import Tensor

import torchbeam as tb
from tests.cases.gradient_ingredients import POLAR
from tests.cases.metamorphic_answers import told
from tests.cases.metamorphic_numbers import HOLDERS, numbered
from tests.cases.metamorphic_parts import NotHere
from tests.cases.metamorphic_runs import RUNS
from tests.cases.metamorphic_said import Pair, Said, engine
from tests.cases.metamorphic_similarity import Similarity
from tests.cases.metamorphic_words import WORDS
from torchbeam.extend import quaternions as quat


def _words(change: Callable, said: Said) -> Pair:
    if change is WORDS["in space"] and said.answer in ("modes", "linearize"):
        raise NotHere  # where there is more to move
    if change is WORDS["rest shape by actuation"] and said.answer != "equilibrium":
        raise NotHere  # its inertia is that of straight elements
    return said.plain, told(said.ask(replace(said.problem, parts=change(said.problem.parts))))


def _turn(said: Said, mirror: bool = False) -> Tensor:
    """A random rotation that the scene can take: of axes to axes where supports hold some of these,
    in its plane where it has one.
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
        Q = torch.eye(3)[draw.sample(range(3), 3)] * torch.tensor(
            [draw.choice((-1.0, 1.0)) for _ in range(3)]
        )
    else:
        Q = quat.matrix(quat.normalize(torch.tensor([draw.gauss(0, 1) for _ in range(4)])))
    return Q if (torch.linalg.det(Q) < 0) == mirror else -Q


def _similar(make: Callable[[Said], Similarity], said: Said) -> Pair:
    s = make(said)
    return said.plain, told(said.ask(said.problem.turned(s)), s.inverse)


def _moved(said: Said) -> Similarity:
    if said.problem.parts["frame"] is not None:
        raise NotHere  # its own motion is told about its origin
    inside = torch.tensor(
        [1.0, 1, 1]
        if said.case.plane is None
        else [float(i in POLAR[said.case.plane]) for i in range(3)]
    )
    return Similarity(origin=inside * torch.tensor([said.random.uniform(-2, 2) for _ in range(3)]))


def _units(said: Said) -> Similarity:
    if any(isinstance(e, tb.StripAir) and e.internal for e in said.problem.parts["effects"]):
        raise NotHere  # whose states are speeds, other than those of users' loads
    draw = said.random
    mass, length, time = (10 ** draw.uniform(-3.0, 3.0) for _ in range(3))
    return Similarity(mass=mass, length=length, time=time)


def _later(said: Said) -> Similarity:
    frame = said.problem.parts["frame"]
    if frame is not None and frame.angular_velocity is not None:
        raise NotHere  # its axes are the inertial ones at t = 0
    return Similarity(shift=said.random.uniform(0.5, 2.0))


def again(said: Said) -> Pair:
    """After a scene of the same code with other numbers."""
    with engine("eager"):
        a = said.of(said.x)
    with engine("auto"):
        said.of({n: v if n in said.case.draw.alone else 1.07 * v for n, v in said.x.items()})
        return a, said.of(said.x)


def _numbers(holder: str, said: Said) -> Pair:
    """After a scene whose functions have another number, which stands where users have their
    numbers.
    """
    p = said.problem
    a = told(said.ask(replace(p, parts=numbered(p.parts, holder, 1.0))))
    with engine("auto"):
        told(said.ask(replace(p, parts=numbered(p.parts, holder, 1.1))))
        b = told(said.ask(replace(p, parts=numbered(p.parts, holder, 1.0))))
    return a | {f"{n} plain": v for n, v in said.plain.items()}, b | {
        f"{n} plain": v for n, v in b.items()
    }


RELATIONS: dict[str, Callable[[Said], Pair]] = {
    "turned": partial(_similar, lambda said: Similarity(turn=_turn(said))),
    "mirrored": partial(_similar, lambda said: Similarity(turn=_turn(said, True))),
    "moved": partial(_similar, _moved), "units": partial(_similar, _units),
    "later": partial(_similar, _later),
    **{f"words: {name}": partial(_words, change) for name, change in WORDS.items()}, "again": again,
    **{f"numbers: {holder}": partial(_numbers, holder) for holder in HOLDERS}, **RUNS,
}  # fmt: skip
# relations that lose derivatives, or are about them
VALUES_ONLY = {
    "t as a list", "restart from a file", "scene from a file", "dual", "vmap", "chunks",
    "single precision", "default dtype",
}  # fmt: skip
