"""Compiled steps beside eager ones where something changes from place to place or from step to
step: values, and gradients by all that it brings.
"""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from studies.effect_costs import table
from tests.cases.compiled_step_cases import moving, section

pytest.importorskip("llvmlite")
FIELDS = (
    "position",
    "rotation",
    "velocity",
    "spin",
    "stress",
    "reaction",
    "work",
    "defect",
    "t",
    "frame",
    "internal",
    "acceleration",
    "straining",
)


class Draw(dict):
    """Tensors by name, made where they are asked for."""

    def __call__(self, name, *shape):
        generator = torch.Generator().manual_seed(len(self))
        self[name] = torch.rand(shape, generator=generator).add_(0.5).requires_grad_()
        return self[name]


def beam(by, N=3, **more):
    return tb.Beam.straight(
        by("length"), N, section(EI=3 * by("EI"), mass=0.5 * by("mass"), **more)
    )


def wave(by, name, size=1.0, axes=(1, 1, 1), mean=0.0):
    """A function of t, `mean` at t = 0, with the rate zero."""
    amplitude, rate, axes = by(name, 3), by(f"{name} rate"), torch.tensor(axes, dtype=torch.float64)
    return lambda t: axes * (mean + size * amplitude * (1 - torch.cos(20 * rate * t)))


def line_loads(by):
    def pull(r, R, v, w, t, k, c, b):
        return -k[..., None] * r - c[..., None] * v * torch.cos(t) + b[..., None] * R[..., 1], None

    turning = by("turning", 3, 3)
    return dict(
        effects=[
            tb.LineLoad(
                force=tb.PerElement(by("force", 2, 3, 3)),
                moment=0.01 * by("moment", 3),
                follower=True,
            ),
            tb.LineLoad(force=tb.PerElement(lambda t: torch.sin(9 * t) * turning), follower=True),
            tb.LineLoad(
                moment=tb.Along(lambda s, t: 0.01 * torch.stack((s * t, torch.cos(s), 0 * s), -1)),
                follower=True,
            ),
            tb.Load(
                pull,
                node=None,
                of=("position", "rotation", "velocity"),
                values=dict(k=by("of all"), c=by("of nodes", 4), b=by("of elements", 2, 3)),
            ),
        ]
    )


def root_motion_in_a_plane(by):
    return dict(
        effects=[tb.Gravity((0, 0, -9.81))],
        plane="xz",
        root=tb.RootMotion(
            displacement=wave(by, "displaced", 0.05, (1, 0, 1)),
            rotation=wave(by, "turned", 0.1, (0, 1, 0)),
        ),
    )


def small_root_motion(by):
    return dict(
        effects=[tb.Gravity((0, 0, -9.81))],
        small=True,
        root=tb.RootMotion(displacement=wave(by, "displaced", 0.01)),
    )


def supports_that_move(by):
    """A clamp with a centre of mass off its node, between supports that hold some of what their
    nodes can do.
    """
    displaced, turned = wave(by, "displaced", 0.05), wave(by, "turned", 0.1)
    effects = [tb.PointMass(0.3, node=1, offset=0.05 * by("offset", 3)), tb.Gravity((0, 0, -9.81))]
    return dict(
        beam=beam(by, 2),
        effects=effects,
        supports=[
            tb.Support(0, rotation=""),
            tb.Support(1, displacement=displaced, turn=turned),
            tb.Support(-1, position="y", rotation="xz", displacement=displaced),
        ],
    )


def elastic_root_that_moves(by):
    return dict(
        effects=[
            tb.Gravity((0, -9.81, 0)),
            tb.RootSpring(100 * by("stiffness", 6), damping=(1.0, 0.1)),
        ],
        plane="xy",
        root=tb.RootMotion(
            displacement=wave(by, "displaced", 0.05, (1, 1, 0)),
            rotation=wave(by, "turned", 0.1, (0, 0, 1)),
        ),
    )


def translating_frame(by):
    return dict(
        effects=[tb.Gravity((0, 0, -9.81)), tb.MassDamping(0.3)],
        plane="xz",
        frame=tb.Frame(velocity=wave(by, "moved", 1.0, (1, 0, 1))),
        supports=[tb.Support(0, rotation="xz"), tb.Support(-1, position="z", rotation="")],
    )


def turning_frame(by):
    """With loads that read the frame's axes: gravity on centres off their nodes, and a flow."""
    return dict(
        effects=[
            tb.Gravity((0, 0, -9.81)),
            tb.PointMass(0.3, offset=0.05 * by("offset", 3)),
            tb.Drag(1000.0, 0.02, flow=by("flow", 3), added_mass=1.0),
        ],
        frame=tb.Frame(velocity=by("frame velocity", 3), angular_velocity=wave(by, "frame", 2.0)),
    )


def turning_frame_in_a_plane(by):
    return dict(
        effects=[tb.TipLoad(force=(2.0, 0, 1.0)), tb.Drag(1000.0, 0.02, flow=(0.3, 0, 0.2))],
        plane="xz",
        supports=(),
        frame=tb.Frame(angular_velocity=wave(by, "turned", 2.0, (0, 1, 0), 1.0)),
    )


def lags(by):
    """Internal states of loads at the tip, all along, and at a node without any motion."""

    def delayed(r, R, v, w, t, z, k):
        return k * z, None

    def along(r, R, v, w, t, z, c):
        return c[..., None] * z * v, R[..., 0] * z

    return dict(
        effects=[
            tb.Load(
                delayed,
                node=-1,
                internal=3,
                of=("position",),
                values=dict(k=by("k")),
                rate=lambda z, r, R, v, w, t, k: (-k * r - z) / 0.02,
            ),
            tb.Load(
                along,
                node=None,
                internal=1,
                of=("position", "rotation", "velocity"),
                values=dict(c=by("c", 3)),
                rate=lambda z, r, R, v, w, t, c: (
                    (v * v).sum(-1, keepdim=True) - 3 * c[..., None] * z
                ),
            ),
            tb.Load(
                lambda r, R, v, w, t, z, u: (u + torch.cat((z, z[..., :1]), -1), None),
                node=1,
                internal=2,
                of=(),
                inputs={"u": 3},
                rate=lambda z, r, R, v, w, t, u: u[..., :2] - z,
            ),
        ]
    )


CASES = {
    make.__name__.replace("_", " "): make
    for make in (
        line_loads,
        root_motion_in_a_plane,
        small_root_motion,
        supports_that_move,
        elastic_root_that_moves,
        translating_frame,
        turning_frame,
        turning_frame_in_a_plane,
        lags,
    )
}


def damped_springs(by):
    """In 3D, with rates of strains, a hinge, and a force that changes over the step."""
    force = by("force", 3)
    return dict(
        beam=beam(by, 2),
        supports=[tb.Support(0, rotation="xz"), tb.Support(-1, position="z", rotation="")],
        effects=[
            tb.Damping(0.01 * by("tau")),
            tb.Spring(1, 50 * by("stiffness"), (0.3, 0.1, 0.2), damping=0.3),
            tb.PointLoad(node=1, force=lambda t: torch.sin(90 * t) * force),
            tb.TipLoad(moment=tb.Input("u", 3), follower=True),
        ],
    )


def clamps_that_move(by):
    """Between a clamp and a support that hold what their nodes do; damped."""
    return dict(
        effects=[tb.Damping(0.01), tb.Gravity((0, 0, -9.81))],
        plane="xz",
        supports=[
            tb.Support(
                0,
                displacement=wave(by, "displaced", 0.05, (1, 0, 1)),
                turn=wave(by, "turned", 0.1, (0, 1, 0)),
            ),
            tb.Support(
                -1, position="z", rotation="", displacement=wave(by, "lifted", 0.05, (1, 0, 1))
            ),
        ],
    )


def pushed_in_a_plane(by):
    """Hard enough from rest that some of the energy's error waits for a later step."""
    push, bent = (
        torch.tensor(axes) * by(name)
        for name, axes in (("push", (20.0, 30.0, 0)), ("bent", (0, 0, 0.5)))
    )
    return dict(
        effects=[
            tb.Damping(0.01 * by("tau")),
            tb.TipLoad(force=push, follower=True),
            tb.MassDamping(0.3),
            tb.Actuation(curvature=bent),
        ],
        plane="xy",
    )


def held_midsides(by):
    """Elements of order 2 in 3D, with a hinge between the ends of each, that moves, and a section
    of its own.
    """
    displaced = wave(by, "displaced", 0.05)
    each = [section(EI=3 * by("EI", 2, 2)[k]) for k in range(2)]
    return dict(
        beam=tb.Beam.straight(by("length"), 2, each, order=2),
        effects=[
            tb.TipLoad(force=3 * by("pull", 3)),
            tb.Damping(0.01 * by("tau")),
            tb.LineLoad(force=tb.PerElement(by("force", 2, 2, 3))),
        ],
        supports=[tb.Support(node, rotation="xz", displacement=displaced) for node in (1, 3)],
    )


def quadratic_in_a_plane(by):
    """Elements of order 2 with a centre of mass off the node between the ends of one."""
    return dict(
        beam=tb.Beam.straight(
            by("length"), 2, section(EI=3 * by("EI"), mass=0.5 * by("mass")), order=2
        ),
        effects=[
            tb.Damping(0.01 * by("tau")),
            tb.TipLoad(force=tb.Input("u", 3), follower=True),
            tb.Drag(1000.0, 0.02, added_mass=1.0),
            tb.PointMass(0.3, offset=by("offset", 3) * torch.tensor((0.02, 0.05, 0)), node=1),
            tb.Actuation(curvature=by("bent", 3) * torch.tensor((0, 0, 1.0))),
            tb.MassDamping(0.3),
            tb.Spring(3, 50 * by("stiffness"), (0.3, 0.1, 0), length=0.1),
        ],
        plane="xy",
    )


def damped_quadratic(by, **where):
    """Elements of order 2 with rates of strains at two stations each."""
    of = section(EI=3 * by("EI"), mass=0.5 * by("mass"))
    return dict(
        where or dict(plane="xz"),
        beam=tb.Beam.straight(by("length"), 2, of, order=2),
        effects=[
            tb.Damping(0.01 * by("tau")),
            tb.Gravity((0, 0, -9.81)),
            tb.TipLoad(force=by("pull") * torch.tensor((1.0, 0, 2.0))),
        ],
    )


def small_quadratic(by):
    return damped_quadratic(by, small=True)


LONG = pytest.mark.long
# the others have parts of these; properties/test_engine_fuzz all
TOLD = line_loads, supports_that_move, turning_frame, lags
ALPHA = [
    damped_springs,
    clamps_that_move,
    *(
        pytest.param(make, marks=LONG)
        for make in (elastic_root_that_moves, line_loads, root_motion_in_a_plane, small_root_motion)
    ),
]


def ran(make, engine, gradient, **options):
    """Four steps of two samples: (states, iterations, a number's gradients)."""
    by = Draw()
    given = make(by)
    scene = tb.Scene(given.pop("beam", None) or beam(by), **given)
    by["t"] = torch.linspace(0, 0.04, 5, requires_grad=True)
    with torch.no_grad():
        start = (
            tb.rest(scene, (2,)) if scene.has_prescribed_motion else moving(scene, (2,), size=0.3)
        )
    if not scene.has_prescribed_motion:
        by["velocity"] = start.velocity.clone().requires_grad_()
    inputs = {name: by(name, 2, size) for name, size in scene.inputs.items()}
    with torch.set_grad_enabled(gradient):
        solution = tb.simulate(
            scene,
            by["t"],
            replace(start, velocity=by.get("velocity", start.velocity)),
            step=0.01,
            inputs=inputs,
            engine=engine,
            **options,
        )
    found = {name: x for name in FIELDS if (x := getattr(solution.state, name, None)) is not None}
    if not gradient:
        return found, solution
    generator = torch.Generator().manual_seed(3)
    value = (
        sum((torch.randn(x.shape, generator=generator) * x).sum() for x in found.values())
        + solution.energy.strain.sum()
    )
    return dict(
        zip(by, torch.autograd.grad(value, list(by.values()), allow_unused=True), strict=True)
    )


@pytest.mark.parametrize(
    "make",
    [
        pytest.param(make, id=name, marks=[LONG] * (make not in TOLD))
        for name, make in CASES.items()
    ],
)
def test_steps_are_the_eager_ones(make):
    compare(make)


@pytest.mark.parametrize("make", ALPHA)
def test_steps_of_generalized_alpha_are_the_eager_ones(make):
    compare(make, method="generalized_alpha", rho_inf=0.7)


@pytest.mark.parametrize(
    "make",
    [pushed_in_a_plane, *(pytest.param(make, marks=LONG) for make in (damped_springs, lags))],
)
def test_steps_that_close_the_energy_balance_are_the_eager_ones(make):
    compare(make, conserve=True)


@pytest.mark.parametrize(
    "make, options",
    [
        (held_midsides, {}),
        (quadratic_in_a_plane, dict(conserve=True)),
        (damped_quadratic, dict(method="generalized_alpha")),
        pytest.param(held_midsides, dict(method="generalized_alpha"), marks=LONG),
        pytest.param(small_quadratic, dict(method="midpoint4"), marks=LONG),
        pytest.param(small_quadratic, dict(method="generalized_alpha"), marks=LONG),
    ],
)
def test_steps_of_elements_of_order_2_are_the_eager_ones(make, options):
    compare(make, **options)


def compare(make, **options):
    """Each field to 1e-12 of its largest number, each gradient to 1e-9."""
    (wanted, eager), (found, compiled) = (
        ran(make, engine, False, **options) for engine in ("eager", "compiled")
    )
    assert not eager.status.any() and not compiled.status.any()
    assert_close(compiled.stats.iterations, eager.stats.iterations)
    for field, x in wanted.items():
        size = max([1e-3, *x.abs().flatten().tolist()])
        assert_close(found[field], x, rtol=0, atol=1e-12 * size, msg=lambda m, f=field: f"{f}: {m}")
    wanted, found = (ran(make, engine, True, **options) for engine in ("eager", "compiled"))
    for field, x in wanted.items():
        assert (x is None) == (found[field] is None), field
        if x is not None:
            assert_close(
                found[field],
                x,
                rtol=0,
                atol=1e-9 * float(x.abs().max()),
                msg=lambda m, f=field: f"{f}: {m}",
            )


@torch.no_grad()
def test_single_steps_and_failures_in_a_frame_that_turns():
    """A sample that is no number, and one that rests: their frames stand, and the others are as
    eager ones.
    """
    scene = tb.Scene(
        tb.Beam.straight(1.0, 2, section()),
        [tb.TipLoad(force=tb.Input("u", 3))],
        plane="xz",
        frame=tb.Frame(angular_velocity=(0, 1.5, 0)),
    )
    u = torch.tensor([[1.0, 0, 2], [torch.nan, 0, 0], [3, 0, 1]])
    active = torch.tensor([True, True, False])
    found = []
    for engine in ("eager", "compiled"):
        stepper = tb.Stepper(scene, 0.01, engine=engine)
        state = stepper(stepper(tb.rest(scene, (3,)), u=u, active=active), u=u[:1], active=active)
        assert state.status.tolist()[::2] == [0, 0] and state.status[1] != 0
        found.append(state)
    for field in ("position", "velocity", "frame", "t"):
        assert_close(getattr(found[1], field), getattr(found[0], field), rtol=0, atol=1e-13)
    assert torch.equal(found[1].frame[1:], tb.rest(scene, (2,)).frame)


@pytest.mark.long
@pytest.mark.parametrize("make", [pytest.param(make, id=name) for name, _, make in table(2)])
def test_every_row_of_the_effects_table_is_as_eager(make):
    """Four steps from the start of a motion: values to 1e-12 of the largest, iterations, gradients
    by the start's velocities to 1e-9. Positions of 1 m are rounded to 1e-16 m, and EA = 1e4 N is
    the largest stiffness: stresses and reactions also to 4 eps EA.
    """
    scene, found = make(), []
    rounding = {
        "stress": 4e4 * torch.finfo(torch.float64).eps,
        "reaction": 4e4 * torch.finfo(torch.float64).eps,
    }
    for engine in ("eager", "compiled"):
        start = tb.rest(scene)
        velocity = start.velocity.clone().requires_grad_(not scene.has_prescribed_motion)
        t, begin = torch.linspace(0, 0.01, 3), replace(start, velocity=velocity)
        with torch.no_grad():
            solution = tb.simulate(scene, t, begin, step=0.0025, engine=engine)
        slope = None
        if velocity.requires_grad:
            value = tb.simulate(scene, t, begin, step=0.0025, engine=engine).state
            (slope,) = torch.autograd.grad(
                value.position.sum() + value.spin.square().sum() + value.work.sum(), velocity
            )
        found.append((solution, slope))
    (eager, wanted), (compiled, slope) = found
    assert not eager.status.any() and torch.equal(compiled.stats.iterations, eager.stats.iterations)
    for field in FIELDS:
        if (x := getattr(eager.state, field, None)) is not None:
            limit = 1e-12 * max([1e-3, *x.abs().flatten().tolist()]) + rounding.get(field, 0.0)
            assert_close(
                getattr(compiled.state, field),
                x,
                rtol=0,
                atol=limit,
                msg=lambda m, f=field: f"{f}: {m}",
            )
    if wanted is not None:
        assert_close(slope, wanted, rtol=0, atol=1e-9 * float(wanted.abs().max()))
