"""Samples that have converged, or have not failed, are left out: the answers are the same to
rounding, which sums products of another shape in another order, and so are derivatives.
"""

import math
from dataclasses import fields

import pytest
import torch

import torchbeam as tb
from torchbeam.core import batch_subset as rows
from torchbeam.scene import effects

B = 7
SOFT = dict(EA=4e3, GA=2e3, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-3)
NAMES = [f.name for f in fields(tb.State) if f.metadata]  # all tensors


def some(*shape, size=1.0):
    """Numbers (B, ...) that differ from sample to sample."""
    return size * torch.randn(B, *shape, generator=torch.Generator().manual_seed(len(shape)))


def spread():
    """Loads (B,) from next to nothing to P L^2/EI = 60: converged in 2 iterations, and made again
    in parts.
    """
    return torch.tensor([60.0, 1e-3, 1.0, 3.0, 0.1, 2.0, 1.0])


def beam(elements=4, batch=True, **changed):
    EI = 1 + 0.1 * torch.arange(B) if batch else 1.0
    return tb.Beam.straight(
        1 + 0.01 * torch.arange(B) if batch else 1.0,
        elements,
        tb.Section.from_stiffness(**{**SOFT, "EI": EI, **changed}),
    )


def tip(P):
    return tb.TipLoad(force=torch.stack((0.1 * P, P, P / 3), -1))


def of_time(t):
    return some(3) * torch.sin(20 * t)


HISTORY = effects.History(torch.tensor([0.0, 0.5]), torch.stack((some(3), -some(3)), -2))
# fmt: off
SCENES = {
    "dead": lambda P: tb.Scene(beam(), [tip(P)]),
    "one beam": lambda P: tb.Scene(beam(batch=False), [tip(P)]),
    "plane": lambda P: tb.Scene(beam(), [tb.TipLoad(force=torch.stack((0 * P, 0 * P, P), -1))],
                                plane="xz"),
    "loads": lambda P: tb.Scene(beam(), [
        tip(P), tb.PointLoad(2, moment=of_time, follower=True), tb.LineLoad(force=HISTORY),
        tb.Gravity(some(3)),
        tb.LineLoad(force=effects.PerElement(some(4, 3))), tb.Damping(some().abs() * 1e-3)]),
    "springs": lambda P: tb.Scene(beam(), [
        tip(P), tb.RootSpring(100 + some(6).abs(), some(6).abs()),
        tb.Spring(-1, some().abs(), of_time, 0.1, 0.1),
        tb.MassDamping(some().abs()), tb.PointMass(some().abs(), offset=some(3, size=0.1))]),
    "flow": lambda P: tb.Scene(beam(),
                               [tip(P),
                                tb.Drag(1.0, 0.1, some().abs(), flow=some(3),
                                        added_mass=some().abs()),
                                        tb.Actuation(curvature=some(3))]),
    "motion": lambda P: tb.Scene(beam(), [tip(P)], frame=tb.Frame(angular_velocity=some(3)),
                                 root=tb.RootMotion(lambda t: some(3, size=0.01) * t,
                                                    lambda t: some(3) * t)),
    "user": lambda P: tb.Scene(beam(),
                               [tip(P), tb.Load(lambda r, R, v, w, t: (-some(3).abs() * v, None),
                                                node=-1)]),
}
# fmt: on
LONG = "one beam", "dead"  # test_large_batch_and_a_sample_alone, and "loads", have what these have


@pytest.fixture(autouse=True)
def eager(monkeypatch):
    """Subsets are the eager engine's: native code holds samples that have converged by a mask."""
    monkeypatch.setenv("TORCHBEAM_ENGINE", "eager")


@pytest.fixture
def least(monkeypatch):
    """Sets from how many samples on some are left out."""
    return lambda n: monkeypatch.setattr(rows, "LEAST", n)


def moved(scene, steps=1, inputs=None, **options):
    stepper = tb.Stepper(scene, 0.05, **options)
    state, counted = stepper.rest(), []
    for _ in range(steps):
        state = stepper(state, **(inputs or {}))
        counted.append(stepper.iterations)
    return state, torch.stack(counted)


def same(a, b):
    """Every field, to 4096 ulp of its largest number: hundreds of parts of steps add their rounding
    up. (To the bit on an AMD Zen 4; 2e-14, or 100 ulp, between batches of 5 and of 150 on an Intel
    Xeon.) Whole numbers are equal.
    """
    return all(
        getattr(a, name) is None or close(getattr(a, name), getattr(b, name)) for name in NAMES
    )


def close(a, b):
    if not b.is_floating_point() or not b.numel():
        return torch.equal(a, b)
    return ((a - b).abs() <= 4096 * torch.finfo(b.dtype).eps * b.abs().max()).all()


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.long] * (name in LONG)) for name in SCENES]
)
def test_motion_in_parts(name, least):
    """Every kind of value that may have a batch axis: smaller batches give the states, status and
    iterations of the whole one, through steps that some samples make again in parts.
    """
    scene = SCENES[name](spread())
    least(10**9)
    whole, counted = moved(scene)
    least(2)
    part, again = moved(scene)
    assert same(part, whole) and torch.equal(counted, again)
    assert (whole.status == 0).all() and counted.max() > 2 * counted.min()


@pytest.mark.parametrize(
    "options", [dict(method="generalized_alpha"), dict(conserve=True)], ids=lambda o: "-".join(o)
)
def test_methods_in_parts(options, least):
    least(10**9)
    whole, _ = moved(SCENES["loads"](spread()), **options)
    least(2)
    assert same(moved(SCENES["loads"](spread()), **options)[0], whole)


@pytest.mark.parametrize("name", ["dead", "plane", "loads", "springs", "motion"])
def test_equilibrium_in_parts(name, least):
    """A load that is raised in steps, each sample at its own pace."""
    if name == "motion":
        scene = tb.Scene(beam(), [tip(spread())], frame=tb.Frame(angular_velocity=some(3)))
    else:
        scene = SCENES[name](spread())
    least(10**9)
    whole = tb.equilibrium(scene, t=0.1)
    least(2)
    assert same(tb.equilibrium(scene, t=0.1), whole)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_large_batch_and_a_sample_alone(dtype):
    """64 samples and the defaults: one that fails in whole steps, others that take 2 to 4
    iterations; each is what it is alone, in either precision.
    """
    P = torch.logspace(-3, 1, 64, dtype=dtype)
    P[20] = 60.0
    beam = tb.Beam.straight(1.0, 4, tb.Section.from_stiffness(**SOFT))

    def run(P):
        return moved(tb.Scene(beam, [tip(P)], dtype=dtype))

    all_, counted = run(P)
    assert counted[:, 20].max() > 12 and counted.min() < 3
    for i in (0, 20, 63):
        alone, again = run(P[i : i + 1])
        assert same(all_[i : i + 1], alone) and torch.equal(counted[:, i : i + 1], again)


def test_samples_that_fail_are_left_out(least):
    """One load that is not a number, one that no part of the step takes: neither changes another or
    its iterations.
    """

    def run(bad, impossible):
        force = (spread() * torch.tensor([1, 1, bad, 1, 1, impossible, 1]))[:, None] * torch.tensor(
            [0.1, 1, 0.3]
        )
        return moved(
            tb.Scene(beam(), [tb.TipLoad(force=tb.Input("f", 3))]), inputs={"f": force}, halvings=5
        )

    least(2)
    state, counted = run(math.nan, 1e30)
    fine, usual = run(1.0, 1.0)
    others = [0, 1, 3, 4, 6]
    assert state.status.tolist() == [0, 0, 2, 0, 0, 1, 0]
    assert same(state[others], fine[others]) and torch.equal(counted[:, others], usual[:, others])


def test_derivatives_through_parts(least):
    """Reverse and forward mode through steps that one sample makes again by itself, against the
    whole batch: the same sums, where a derivative by what all share adds its samples in another
    order (1e-12 of numbers near one).
    """

    def run(P, EI):
        section = tb.Section.from_stiffness(**{**SOFT, "EI": EI})
        state, counted = moved(tb.Scene(tb.Beam.straight(1.0, 4, section), [tip(P)]))
        return state.tip.position, counted

    found = []
    for n in (10**9, 2):
        least(n)
        P, EI = spread().requires_grad_(), torch.tensor(1.0, requires_grad=True)
        position, counted = run(P, EI)
        assert counted[:, 0].max() > 12 and counted[:, 1:].max() < 12
        reverse = torch.autograd.grad(position.square().sum(), (P, EI))
        forward = torch.func.jvp(
            lambda P, EI: run(P, EI)[0], (P.detach(), EI.detach()), (torch.ones(B), torch.ones(()))
        )[1]
        found.append((*reverse, forward))
    for whole, part in zip(*found, strict=True):
        torch.testing.assert_close(part, whole, rtol=1e-12, atol=1e-12)
