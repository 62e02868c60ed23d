"""Second derivatives, asked for in every way: right against differences of first ones, or refused
by a sentence, never a number that lacks a part.
"""

import re
from functools import partial

import pytest
import torch
import torch.autograd.forward_ad as dual
from torch import func

import torchbeam as tb

AT = torch.tensor([1.0, 0.8])  # EI and load
LIGHT = torch.tensor([1.0, 1e-6])  # a load that the undeformed beam is in equilibrium under
BASIS = torch.eye(2)
EXACT = dict(tolerance=1e-12)


def scene(p, *effects, **parts):
    section = tb.Section.from_stiffness(
        EA=100.0, GA=50.0, GJ=0.8, EI=(p[0], 1.7 * p[0]), mass=0.2, inertia=1e-3
    )
    load = tb.TipLoad(force=p[1] * torch.tensor([0.2, 1.0, 0.5]))
    return tb.Scene(tb.Beam.straight(1.0, 2, section), [load, *effects], **parts)


def moved(p, engine, **options):
    options = {"step": 0.02, **options} if "rtol" not in options else options
    return tb.simulate(scene(p), [0.0, 0.02], engine=engine, **EXACT, **options).tip.position[-1]


def stepped(p, engine):
    stepper = tb.Stepper(scene(p), 0.02, engine=engine, **EXACT)
    return stepper(stepper.rest()).tip.position


def rolled(p, engine):
    stepper = tb.Stepper(scene(p), 0.02, engine=engine, **EXACT)
    return tb.rollout(stepper, stepper.rest(), 1).tip.position[-1]


def stopped(p, engine):
    """When the tip has moved by 1 mm."""
    solution = tb.simulate(
        scene(p), [0.0, 0.05], engine=engine, rtol=1e-2,
        events=lambda s: s.tip.position[..., 1] - 1e-3,
    )  # fmt: skip
    return (
        solution.stats.event_time
        if hasattr(solution.stats, "event_time")
        else solution.states.t[-1]
    )


def compressed(p):
    def at(factor):
        return tb.Scene(
            scene(p).beam, [tb.TipLoad(force=factor[..., None] * torch.tensor([-1.0, 0, 0]))]
        )

    return tb.critical_load(at, 8.0, points=3).factor


def linear(p, state=tb.rest):
    return tb.linearize(scene(p * LIGHT), state(scene(p * LIGHT)))


# fmt: off
QUANTITIES = {
    "equilibrium": lambda p: tb.equilibrium(scene(p), **EXACT).tip.position,
    "reaction": lambda p: tb.equilibrium(scene(p), **EXACT).reaction,
    "small rotations": lambda p: tb.equilibrium(scene(p, small=True), **EXACT).tip.position,
    "modes": lambda p: tb.modes(scene(p * LIGHT), tb.rest(scene(p * LIGHT)), count=2).frequency,
    "damped modes": lambda p: tb.modes(scene(p * LIGHT, tb.Damping(1e-3)),
                                       tb.rest(scene(p * LIGHT)), count=2).damping_ratio,
    "modes of an equilibrium": lambda p: tb.modes(scene(p), count=2).frequency,
    "shape": lambda p: tb.modes(scene(p * LIGHT), tb.rest(scene(p * LIGHT)), count=2,
                                normalize="mass").shape.abs(),
    "linear model": lambda p: linear(p).A,
    "discrete linear model": lambda p: linear(p).discrete(0.01).A,
    "critical load": compressed,
    "rk4": lambda p: tb.simulate(scene(p), torch.linspace(0, 0.008, 5),
                                 method="rk4").tip.position[-1],
    "strain energy": lambda p: tb.simulate(scene(p), [0.0, 0.02], step=0.02,
                                           engine="eager").energy.strain[-1],
}
# fmt: on
MOTIONS = {
    "midpoint": moved,
    "conserving": partial(moved, conserve=True),
    "midpoint4": partial(moved, method="midpoint4"),
    "generalized alpha": partial(moved, method="generalized_alpha"),
    "checkpoint": partial(moved, checkpoint=True),
    "tolerance": partial(moved, rtol=1e-2),
    "stepper": stepped,
    "rollout": rolled,
    "event": stopped,
}  # fmt: skip
QUANTITIES |= {
    f"{name}, {engine}": partial(function, engine=engine)
    for name, function in MOTIONS.items()
    for engine in ("eager", "compiled")
}
SHORT = {  # others: long
    ("equilibrium", False),
    ("modes", False),
    ("midpoint, eager", False),
    ("midpoint, compiled", False),
    ("midpoint, compiled", True),
    ("conserving, compiled", False),
    ("checkpoint, compiled", False),
}


def rows(vectors):
    return torch.stack(list(vectors))


def reverse_twice(f, p):
    p = p.clone().requires_grad_()
    (slope,) = torch.autograd.grad(f(p), p, create_graph=True)
    return rows(torch.autograd.grad(x, p, retain_graph=True)[0] for x in slope)


def reverse_twice_by_a_part(f, p):
    """The first by a tensor inside, the second by what that is made from."""
    p = p.clone().requires_grad_()
    inner = 1.0 * p
    (slope,) = torch.autograd.grad(f(inner), inner, create_graph=True)
    return rows(torch.autograd.grad(x, p, retain_graph=True)[0] for x in slope)


def forward_over_reverse(f, p):
    def product(direction):
        with dual.dual_level():
            q = dual.make_dual(p.clone().requires_grad_(), direction)
            tangent = dual.unpack_dual(torch.autograd.grad(f(q), q)[0]).tangent
            return torch.zeros(2) if tangent is None else tangent

    return rows(map(product, BASIS))


def reverse_over_forward(f, p):
    def product(direction):
        with dual.dual_level():
            q = p.clone().requires_grad_()
            return torch.autograd.grad(
                dual.unpack_dual(f(dual.make_dual(q, direction))).tangent, q
            )[0]

    return rows(map(product, BASIS))


WAYS = {
    "reverse twice": reverse_twice,
    "reverse twice by a part": reverse_twice_by_a_part,
    "forward over reverse": forward_over_reverse,
    "reverse over forward": reverse_over_forward,
    "autograd.functional.hessian": torch.autograd.functional.hessian,
    "func.hessian": lambda f, p: func.hessian(f)(p),
    "jacrev(jacrev)": lambda f, p: func.jacrev(func.jacrev(f))(p),
    "jacfwd(jacfwd)": lambda f, p: func.jacfwd(func.jacfwd(f))(p),
    "jvp(grad)": lambda f, p: rows(func.jvp(func.grad(f), (p,), (x,))[1] for x in BASIS),
    "grad(jvp)": lambda f, p: rows(
        func.grad(lambda q, x=x: func.jvp(f, (q,), (x,))[1])(p) for x in BASIS
    ),
}
REFUSED = "first ones only"
# what is refused in ways of its own, which have nothing to do with second derivatives
OTHERWISE = {
    "checkpoint": "don't yet support saved tensor hooks|saved tensor hooks",
    "tolerance": "within torch.func.vmap",
    "event": "within torch.func.vmap",
}


def differences(f, p, h=1e-4):
    """Of first derivatives; and what these leave of their rounding, eight last places of the
    largest.
    """

    def slope(p):
        p = p.clone().requires_grad_()
        return torch.autograd.grad(f(p), p)[0]

    more, less = (rows(slope(p + sign * h * x) for x in BASIS) for sign in (1, -1))
    return (more - less) / (2 * h), 8 * torch.finfo(p.dtype).eps * more.abs().max() / h


@pytest.mark.parametrize(
    "what, squared",
    [
        pytest.param(what, squared, marks=[pytest.mark.long] * ((what, squared) not in SHORT))
        for what in QUANTITIES
        for squared in (False, True)
    ],
)
def test_second_derivatives_are_right_or_refused(what, squared):
    """Of a sum and of a sum of squares: the gradient of a sum knows no graph of what comes behind
    it. What comes back agrees with central differences of first derivatives to 1e-4, and rounding.
    """
    if what.endswith("compiled"):
        pytest.importorskip("llvmlite")

    def f(p):
        y = QUANTITIES[what](p)
        return (y.square() if squared else y).sum()

    exact = rounding = None
    for way, second in WAYS.items():
        try:
            found = second(f, AT)
        except NotImplementedError as error:
            assert REFUSED in str(error), way
            continue
        except (RuntimeError, ValueError) as error:
            known = OTHERWISE.get(what.split(",")[0])
            if known is None or not re.search(known, str(error)):
                raise AssertionError(f"{way}: {error}") from error
            continue
        exact, rounding = differences(f, AT) if exact is None else (exact, rounding)
        assert (found - exact).abs().max() < 1e-4 * exact.abs().max() + rounding, way
