"""The compiled step beside the eager one: the same states, statuses and iterations, whatever is in
the batch.
"""

import pickle
from copy import deepcopy
from dataclasses import replace
from functools import partial

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.compiled_step_cases import (
    everything,
    inputs_of,
    moving,
    same_fields,
    section,
    straight,
)

pytest.importorskip("llvmlite")
FIELDS = ("position", "rotation", "velocity", "spin", "stress", "reaction", "work", "t")
GRADIENT = torch.tensor(0.3, requires_grad=True)
SCENES = {
    "everything": everything,
    "everything in a plane": lambda: everything("xz"),
    "inextensible": lambda: tb.Scene(
        straight(of=section(EA=torch.inf, GA=torch.inf)), [tb.TipLoad(force=(0, 1.0, 0))]
    ),
}
same = partial(same_fields, FIELDS)


@pytest.mark.parametrize("name", SCENES)
@torch.no_grad()
def test_a_rollout_is_the_eager_one(name):
    """Seven steps of nine samples that move differently, as many iterations: to 1e-12 of each
    field; where strains are impossible to 1e-11, as the tangent's condition is 1e7.
    """
    scene = SCENES[name]()
    start, inputs = moving(scene, (9,)), inputs_of(scene, (9,))
    t = torch.tensor([0, 0.01, 0.05, 0.07])
    wanted, found = (
        tb.simulate(scene, t, start, step=0.01, inputs=inputs, engine=engine)
        for engine in ("eager", "compiled")
    )
    assert wanted.stats.iterations.min() >= 1 and not wanted.status.any()
    same(found.state, wanted.state, 1e-11 if name == "inextensible" else 1e-12)
    assert_close(found.stats.iterations, wanted.stats.iterations)
    assert_close(found.energy.kinetic, wanted.energy.kinetic)


def arm(**options):
    return tb.Scene(
        straight(4), [tb.Gravity((0, 0, -9.81)), tb.TipLoad(force=tb.Input("u", 3))], **options
    )


@pytest.fixture(scope="module")
def stepper():
    return tb.Stepper(arm(), 0.01, engine="compiled")


def stepped(stepper, state, steps=3, **given):
    for _ in range(steps):
        state = stepper(state, **given)
    return state


@pytest.fixture(scope="module")
def quadratic():
    scene = tb.Scene(
        straight(2, order=2),
        [tb.Gravity((0, 0, -9.81)), tb.TipLoad(force=tb.Input("u", 3))],
        plane="xz",
    )
    return tb.Stepper(scene, 0.01, engine="compiled")


@pytest.mark.parametrize("name", ["stepper", "quadratic"])
@torch.no_grad()
def test_a_sample_alone_is_the_same_in_any_batch(name, request):
    """Lanes do not mix: to 1e-13, as scalars and vectors may fuse other products."""
    stepper = request.getfixturevalue(name)
    start = moving(stepper.scene, (17,))
    u = torch.randn(17, 3) * torch.tensor([1.0, stepper.scene.plane is None, 1.0])
    whole = stepped(stepper, start, u=u)
    for count in (1, 3, 8, 9):
        same(stepped(stepper, start[:count], u=u[:count]), whole[:count], 1e-13)
    same(stepped(stepper, start[0], u=u[0]), whole[0], 1e-13)
    same(
        stepped(
            stepper, start.map(lambda x: x[:6].unflatten(0, (2, 3))), u=u[:6].unflatten(0, (2, 3))
        ),
        whole[:6].map(lambda x: x.unflatten(0, (2, 3))),
        1e-13,
    )


@torch.no_grad()
def test_what_is_no_number_harms_nobody(stepper):
    start = moving(stepper.scene, (9,))
    u = torch.randn(9, 3)
    broken = u.clone()
    broken[4] = torch.nan
    whole, found = (stepped(stepper, start, u=x) for x in (u, broken))
    eager = stepped(tb.Stepper(stepper.scene, 0.01), start, u=broken)
    assert found.status.tolist() == eager.status.tolist() and found.status[4] != 0
    others = [k for k in range(9) if k != 4]
    same(found[others], whole[others], 0.0)
    same(found, eager)


@torch.no_grad()
def test_hard_steps_end_as_eager_ones(stepper):
    """Forces of 0.1 to 1e6 N, NaN and inf, steps of 5 to 100 ms: the same statuses, and the same
    counts, of the parts that a failed step is made in too. What has converged is the same to 1e-10:
    hundreds of iterations on the way.
    """
    eager = tb.Stepper(stepper.scene, 0.01)
    u = torch.tensor([0.1, 10.0, 1e3, 1e4, 1e6, torch.nan, torch.inf])[:, None] * torch.tensor(
        [0.0, 1.0, 0.3]
    )
    for dt in (0.005, 0.1):
        start = stepper.rest((7,))
        wanted, found = eager(start, dt=dt, u=u), stepper(start, dt=dt, u=u)
        same(found, wanted, 1e-10)
        assert stepper.iterations.tolist() == eager.iterations.tolist()


@torch.no_grad()
def test_failures_within_a_rollout_are_made_as_by_themselves():
    scene = arm()
    u = torch.tensor([[0.0, 1.0, 0.3], [0.0, 4e3, 0.0], [torch.nan, 0.0, 0.0]])
    t = torch.linspace(0, 0.1, 6)
    with pytest.warns(RuntimeWarning):
        wanted, found = (
            tb.simulate(scene, t, inputs={"u": u}, step=0.01, engine=engine)
            for engine in ("eager", "compiled")
        )
    same(found.state, wanted.state, 1e-10)
    assert_close(found.stats.iterations, wanted.stats.iterations)


@torch.no_grad()
def test_samples_that_rest_and_steps_of_their_own(stepper):
    start, u = moving(stepper.scene, (9,)), torch.randn(9, 3)
    active, dt = torch.arange(9) % 3 > 0, torch.linspace(0.002, 0.02, 9)
    eager = tb.Stepper(stepper.scene, 0.01)
    found, wanted = (x(start, active=active, dt=dt, u=u) for x in (stepper, eager))
    same(found, wanted)
    same(found[~active], start[~active], 0.0)
    assert stepper.iterations.tolist() == eager.iterations.tolist()


@torch.no_grad()
def test_copies_step_alike(stepper):
    start, u = moving(stepper.scene, (2,)), torch.ones(2, 3)
    for copied in (pickle.loads(pickle.dumps(stepper)), deepcopy(stepper)):
        same(copied(start, u=u), stepper(start, u=u), 0.0)


@pytest.mark.parametrize("N, order, plane", [(4, 1, None), (2, 2, "xz")])
@torch.no_grad()
def test_single_precision(N, order, plane):
    section = tb.Section.from_stiffness(2e3, 8e2, 2.0, 3.0, 0.5, 1e-3)
    beam = tb.Beam.straight(1.0, N, section, order=order)
    effects = [tb.Gravity((0, 0, -9.81)), tb.TipLoad(force=tb.Input("u", 3))]
    scene = tb.Scene(beam, effects, plane=plane, dtype=torch.float32)
    start = moving(scene, (5,))
    u = torch.randn(5, 3, dtype=torch.float32)
    u[:, 1] *= plane is None
    found, wanted = (
        stepped(tb.Stepper(scene, 0.01, engine=engine), start, u=u)
        for engine in ("compiled", "eager")
    )
    assert found.position.dtype == torch.float32
    same(found, wanted, 2e-4)  # the tolerance of Newton's method is 1e-4


def test_functions_bring_axes_of_their_own():
    """Fast enough that a velocity is no rounding of places of 1 m over a step of 10 ms."""
    many = 100 * torch.randn(4, 1, 3)
    scene = tb.Scene(straight(2), [tb.TipLoad(force=lambda t: many * t)])
    found, wanted = (
        tb.Stepper(scene, 0.01, engine=engine)(tb.rest(scene)) for engine in ("compiled", "eager")
    )
    same(found.broadcast(), wanted.broadcast())
    # of which the trial step brings them along before
    for method in ("midpoint", "generalized_alpha"):
        t = [0.0, 0.01, 0.03]
        runs = [
            tb.simulate(scene, t, method=method, step=0.01, engine=engine)
            for engine in ("compiled", "eager")
        ]
        assert all(run.status.shape == (4, 1) for run in runs)
        same(runs[0].state.broadcast(), runs[1].state.broadcast())


@torch.no_grad()
def test_what_a_load_closes_over_is_taken_when_the_stepper_is_made():
    held = [0.3]
    scene = tb.Scene(
        straight(1), [tb.Load(lambda r, R, v, w, t: (held[0] * v - r, None), node=-1)], plane="xz"
    )
    start = moving(scene)
    found = []
    for held[0] in (0.3, 30.0):
        stepper = tb.Stepper(scene, 0.01, engine="compiled")
        same(stepper(start), tb.Stepper(scene, 0.01)(start))
        found.append(stepper(start).work)
    assert found[0] != found[1]


@pytest.mark.parametrize(
    "reason, scene",
    [
        (
            "control flow",
            lambda: tb.Scene(
                straight(2),
                [tb.Load(lambda r, R, v, w, t: (v if v.sum() > 0 else -v, None), node=-1)],
            ),
        ),
        (
            "carries gradient",
            lambda: tb.Scene(
                straight(2),
                [
                    tb.Load(  # what else the function does is not known
                        lambda r, R, v, w, t: (GRADIENT * v + 0 * (print() or 0), None), node=-1
                    )
                ],
            ),
        ),
    ],
)
def test_what_is_not_covered_is_refused_by_name(reason, scene):
    with pytest.raises(
        ValueError, match=f"engine = 'compiled' was given.*({reason}).*'eager' does"
    ):
        tb.Stepper(scene(), 0.01, engine="compiled")
    tb.Stepper(scene(), 0.01)


def test_without_llvmlite_the_package_is_named(monkeypatch):
    monkeypatch.setattr("torchbeam.engine.chain.coverage.installed", lambda: False)
    with pytest.raises(ValueError, match="pip install llvmlite"):
        tb.Stepper(arm(), 0.01, engine="compiled")
    with pytest.raises(ValueError, match="engine = 'native' was given"):
        tb.Stepper(arm(), 0.01, engine="native")


def test_memory_of_failed_samples_is_as_eager_ones(stepper):
    start = replace(stepper.rest((2,)), status=torch.tensor([0, 1]))
    found = stepper(start, u=torch.ones(2, 3))
    assert found.status.tolist() == [0, 1] and torch.equal(found.position[1], start.position[1])
