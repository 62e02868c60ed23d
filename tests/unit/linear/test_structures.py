"""Modes, critical loads and equilibria of structures: a welded beam is the beam; joints leave what
they leave.
"""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

SECTION = dict(EA=1e3, GA=5e2, GJ=0.7, EI=1.0, mass=0.3, inertia=1e-3)
LOAD = {"F": torch.tensor([-1.0, 0.0, 0.0])}
HALVES = [tb.Weld(("a", -1), ("b", 0))]


def halves(order=1, **section):
    section = tb.Section.from_stiffness(**SECTION | section)
    return {
        "a": tb.Beam.straight(0.5, 2, section, order=order),
        "b": tb.Beam.straight(0.5, 2, section, root=(0.5, 0, 0), order=order),
    }


def scenes(order=1, plane=None, **section):
    """(the beam, the welded halves): clamped, with a force at the tip."""
    whole = tb.Beam.straight(1.0, 4, tb.Section.from_stiffness(**SECTION | section), order=order)
    force = tb.Input("F", 3)
    return (
        tb.Scene(whole, [tb.TipLoad(force=force)], plane=plane),
        tb.Scene(
            halves(order, **section),
            [tb.PointLoad(("b", -1), force=force)],
            joints=HALVES,
            supports=[tb.Support(("a", 0))],
            plane=plane,
        ),
    )


@pytest.mark.parametrize(("order", "plane"), [(1, None), (2, "xy")])
def test_a_beam_that_was_welded_has_the_modes_of_the_beam(order, plane):
    """About an equilibrium under load; frequencies and shapes, these node by node."""
    given = {"F": torch.tensor([-0.3, 0.5, 0.0])}
    one, two = (tb.modes(scene, count=3, inputs=given) for scene in scenes(order, plane))
    assert_close(one.frequency, two.frequency, rtol=1e-9, atol=0)
    n = one.shape.shape[-2] // 2 + 1
    rows = [*range(n), *range(n + 1, 2 * n)]
    agree = [
        (a * b).sum() / (a.norm() * b.norm())
        for a, b in zip(one.shape.real, two.shape.real[:, rows], strict=True)
    ]
    assert_close(torch.stack(agree).abs(), torch.ones(3), rtol=0, atol=1e-9)


def test_a_welded_column_buckles_as_the_column():
    """By divergence, under the same load; with its derivative by the stiffness."""
    EI, e = torch.tensor(1.0, requires_grad=True), torch.tensor([0.0, 1e-3, -1e-3])
    one = tb.critical_load(scenes(plane="xy", EI=1.0 + e)[0], 4.0, points=5, inputs=LOAD).factor
    two = tb.critical_load(scenes(plane="xy", EI=EI)[1], 4.0, points=5, inputs=LOAD)
    assert_close(one[0], two.factor.detach(), rtol=1e-7, atol=0)
    assert int(two.kind) == 1
    (slope,) = torch.autograd.grad(two.factor, EI)
    assert_close(slope, (one[1] - one[2]) / 2e-3, rtol=1e-4, atol=0)


def test_a_hinge_leaves_one_motion_of_no_frequency():
    """Nothing holds the second half of a hinged beam: a frequency of zero beside those of the beam;
    as many modes as free moves less constraints.
    """
    scene = tb.Scene(
        halves(),
        joints=[tb.Hinge(("a", -1), ("b", 0), axis=(0, 1, 0))],
        supports=[tb.Support(("a", 0))],
    )
    found = tb.modes(scene, tb.rest(scene), count=5 * 6 - 5).frequency
    assert found[0] < 1e-6 < 1.0 < found[1]
    with pytest.raises(ValueError, match="25 modes"):
        tb.modes(scene, tb.rest(scene), count=26)


@pytest.mark.parametrize(
    "rub", [dict(damping=0.02), dict(friction=0.002, slip_speed=0.1)], ids=["damping", "friction"]
)
def test_what_damps_a_joint_damps_its_mode(rub):
    """A body on a hinge with a spring: J q'' + c q' + k q = 0; friction is a damper of mu over the
    slip speed.
    """
    scene = tb.Scene(
        {"wheel": tb.Body(0.3, 0.01)},
        joints=[tb.Hinge(None, "wheel", axis=(0, 1, 0), stiffness=0.5, **rub)],
    )
    found = tb.modes(scene, count=1)
    assert_close(found.eigenvalue.abs(), torch.tensor([(0.5 / 0.01) ** 0.5]), rtol=1e-9, atol=0)
    assert_close(
        found.damping_ratio, torch.tensor([0.02 / (2 * (0.5 * 0.01) ** 0.5)]), rtol=1e-9, atol=0
    )


def test_modes_without_any_stiffness_are_rigid_motions():
    """Of a wheel, and of a body that nothing holds: no frequency, each motion its own."""
    wheel = tb.Scene({"wheel": tb.Body(0.3, 0.01)}, joints=[tb.Hinge(None, "wheel")])
    adrift = tb.Scene({"body": tb.Body(0.3, (0.01, 0.02, 0.03))})
    assert_close(tb.modes(wheel, count=1).frequency, torch.zeros(1))
    found = tb.modes(adrift, count=6)
    assert_close(found.frequency, torch.zeros(6))
    assert torch.linalg.matrix_rank(found.shape.real.flatten(1)) == 6


@pytest.mark.parametrize("damping", [None, 0.1])
def test_an_inverted_pendulum_falls(damping):
    """A body that a spring of k holds up, pushed down by a force on its centre at the height h: F
    h = k, damped or not, though past that nothing of its stiffness is positive.
    """

    def of(factor):
        down = torch.as_tensor(factor)[..., None] * torch.tensor([0.0, 0.0, -1.0])
        return tb.Scene(
            {"pole": tb.Body(2.0, 0.05, position=(0, 0, 0.5))},
            [tb.PointLoad("pole", force=down)],
            joints=[
                tb.Hinge(None, "pole", at=(0, 0, 0), axis=(0, 1, 0), stiffness=3.0, damping=damping)
            ],
        )

    assert_close(tb.critical_load(of, 20.0, points=5).factor, torch.tensor(6.0), rtol=1e-6, atol=0)


def test_derivative_of_modes_of_a_strut():
    """By a bending stiffness, with a rod to the ground, against a difference."""

    def frequency(EI):
        scene = tb.Scene(
            halves(EI=EI),
            [tb.Gravity((0, 0, -9.81))],
            supports=[tb.Support(("a", 0))],
            joints=[
                tb.Hinge(("a", -1), ("b", 0), axis=(0, 1, 0)),
                tb.Distance(("b", -1), None, at=(1.0, 0, 1.0)),
            ],
        )
        return tb.modes(scene, count=3).frequency[1]

    EI = torch.tensor(1.0, requires_grad=True)
    (slope,) = torch.autograd.grad(frequency(EI), EI)
    assert_close(slope, (frequency(1.0 + 1e-4) - frequency(1.0 - 1e-4)) / 2e-4, rtol=1e-4, atol=0)


def test_vmap_over_equilibria_is_the_batch():
    """With a rigid motion that the load holds."""

    def tip(EI):
        scene = tb.Scene(
            halves(EI=EI),
            [tb.Gravity((0, 0, -9.81))],
            supports=[tb.Support(("a", 0))],
            joints=[tb.Hinge(("a", -1), ("b", 0), axis=(0, 1, 0))],
        )
        return tb.equilibrium(scene, relax=True, throw=False).position[..., -1, :]

    EI = torch.tensor([1.0, 2.0])
    assert_close(torch.func.vmap(tip)(EI), tip(EI), rtol=0, atol=1e-7)


def arm(**elbow):
    """Two links with a hand, sprung and damped hinges, and motors."""
    hinges = {
        "axis": (0, 1, 0),
        "stiffness": torch.tensor(10.0),
        "damping": 0.05,
        "torque": tb.Input("motors", 1),
    }
    return tb.Scene(
        {**halves(), "hand": tb.Body(0.1, 1e-4, position=(1.1, 0, 0))},
        [tb.Gravity((0, 0, -9.81)), tb.PointLoad("hand", force=tb.Input("F", 3)), tb.Damping(0.01)],
        joints=[
            tb.Hinge(None, ("a", 0), at=(0, 0, 0), **hinges),
            tb.Hinge(("a", -1), ("b", 0), **hinges | elbow),
            tb.Weld(("b", -1), "hand"),
        ],
    )


def apart(*effects):
    """No rotary inertia, and a weld across a gap, which gives some of it to turns there."""
    section = tb.Section.from_stiffness(**SECTION | {"inertia": 0.0})
    post = {"root": (0.6, 0, 0.1), "direction": (1, 0, 1)}
    beams = {"a": tb.Beam.straight(0.5, 2, section), "b": tb.Beam.straight(0.5, 2, section, **post)}
    load = tb.PointLoad(("b", -1), force=tb.Input("F", 3))
    return tb.Scene(beams, [load, *effects], joints=HALVES, supports=[tb.Support(("a", 0))])


def four_bar(stiffness=5.0, foot=(0.0, 0.0, 0.0), inertia=None):
    """A loop in a plane, of a crank on a spring and with a rotor, a beam and a rocker."""
    rod = tb.Beam.straight(0.5, 2, tb.Section.from_stiffness(**SECTION), root=(0, 0, 0.2))
    parts = {
        "crank": tb.Body(0.5, 0.02, position=(0, 0, 0.1)),
        "rod": rod,
        "rocker": tb.Body(0.4, 0.02, position=(0.5, 0, 0.15)),
    }
    pins = foot, (0, 0, 0.2), (0.5, 0, 0.2), (0.5, 0, 0)
    ends = (None, "crank"), ("crank", ("rod", 0)), (("rod", -1), "rocker"), ("rocker", None)
    return tb.Scene(
        parts,
        [tb.Gravity((0, 0, -9.81)), tb.PointLoad("crank", force=tb.Input("F", 3))],
        plane="xz",
        joints=[
            tb.Hinge(*pair, at=at, **(dict(stiffness=stiffness, inertia=inertia) if k == 0 else {}))
            for k, (pair, at) in enumerate(zip(ends, pins, strict=True))
        ],
    )


@pytest.mark.parametrize(
    "scene",
    [arm(), apart(), apart(tb.Damping(0.01)), four_bar(), arm(inertia=0.02), four_bar(inertia=0.1)],
    ids=["arm", "massless", "massless, damped", "four-bar", "rotor", "four-bar, rotor"],
)
def test_a_linear_model_steps_as_the_structure(scene):
    """Two midpoint steps of the linear model are the derivative of those of the structure by its
    inputs (central differences of 1e-3: 1e-6 of second order), for all of z, for places and angles
    after the steps and the joints' forces over the last one. Its eigenvalues are the modes.
    """
    given = {name: torch.full((size,), 0.1) for name, size in scene.inputs.items()}
    forces = [tb.sensors.JointLoad(k) for k in range(len(scene.joints))]
    sensors = [lambda state: state.nodes[-1], *forces]
    start = tb.equilibrium(scene, inputs=given, tolerance=1e-12)
    model, h = tb.linearize(scene, start, sensors, inputs=given), 0.02
    modes = tb.modes(scene, start, count=3, inputs=given)
    found = torch.linalg.eigvals(model.A)
    found = found[found.imag > 0]
    assert_close(found[found.abs().argsort()][:3], modes.eigenvalue, rtol=1e-8, atol=1e-8)
    stepper = tb.Stepper(scene, h, tolerance=1e-14, engine="eager")
    du = {name: 1e-3 * torch.arange(1.0, size + 1) for name, size in scene.inputs.items()}

    def read(sign):
        state = start
        for _ in range(2):
            state = stepper(state, **{name: given[name] + sign * du[name] for name in given})
        return model.departure(state), torch.cat([sensor(state) for sensor in sensors])

    z, push = torch.zeros(model.A.shape[-1]), model.B @ torch.cat([du[name] for name in given])
    eye = torch.eye(len(z))
    for _ in range(2):
        before = z
        z = torch.linalg.solve(eye - h / 2 * model.A, (eye + h / 2 * model.A) @ z + h * push)
    (departure, read_more), (back, read_less) = read(1), read(-1)
    size = z.abs().max()
    assert_close((departure - back) / 2, z, rtol=0, atol=2e-6 * size.item())
    wanted = model.C @ torch.stack((z, (z + before) / 2), -1)
    wanted = torch.cat((wanted[:3, 0], wanted[3:, 1])) + model.D @ torch.cat([*du.values()])
    for rows in model.outputs:
        size = wanted[rows].abs().max()
        assert_close(
            (read_more - read_less)[rows] / 2, wanted[rows], rtol=0, atol=2e-6 * size.item()
        )


def test_derivatives_of_a_linear_model_of_a_structure():
    """By stiffness, place and inertia of a hinge, of a batch, against differences."""
    sensors = tb.sensors.JointLoad(0), tb.sensors.JointLoad(1)
    given = {"F": torch.tensor([0.1, 0.0, 0.3])}
    weight = torch.linspace(0.1, 1, 36).view(12, 3)

    def response(k, at, inertia):
        scene = four_bar(k, torch.stack((0 * at, 0 * at, at), -1), inertia)
        found = tb.linearize(scene, outputs=sensors, inputs=given).response(3.0).abs()
        return (found * weight).sum((-1, -2))

    values = torch.tensor([[2.0, 5.0], [0.01, -0.02], [0.1, 0.05]]).unbind()
    traced = [x.clone().requires_grad_() for x in values]
    slopes = torch.autograd.grad(response(*traced).sum(), traced)
    for k, slope in enumerate(slopes):
        moved = [[x + sign * 1e-5 * (i == k) for i, x in enumerate(values)] for sign in (1, -1)]
        difference = (response(*moved[0]) - response(*moved[1])) / 2e-5
        assert_close(slope, difference, rtol=1e-5, atol=1e-6)


def test_the_turn_of_a_joint_is_one_coordinate_however_far():
    """The departure of an elbow that is bent between straight beams is linear in the angle: over
    a turn as at 0.1.
    """

    def elbow(**law):
        hinge = tb.Hinge(("a", -1), ("b", 0), axis=(0, 1, 0), **law)
        return tb.Scene(halves(), joints=[hinge], supports=[tb.Support(("a", 0))])

    drawn = elbow(stiffness=1.0)
    model = tb.linearize(drawn, tb.rest(drawn))
    near, far = (model.departure(tb.equilibrium(elbow(angle=x), tolerance=1e-12)) for x in (0.1, 7))
    assert near.abs().max() > 0.01
    assert_close(far, 70 * near, rtol=0, atol=1e-8)


def test_what_a_linear_model_of_a_structure_has_not():
    given = {"angle": tb.Input("bend", 1), "stiffness": None, "damping": None, "torque": None}
    with pytest.raises(ValueError, match="a Hinge whose coordinate is an Input was given"):
        tb.linearize(arm(**given), inputs={"F": (0, 0, 0), "motors": 0.0, "bend": 0.1})


def test_modes_of_a_batch_are_those_of_each():
    """Of halves on a hinge with three springs: more modes than samples, and fewer."""

    def of(k):
        hinge = tb.Hinge(("a", -1), ("b", 0), axis=(0, 1, 0), stiffness=k)
        return tb.Scene(halves(), joints=[hinge], supports=[tb.Support(("a", 0))], plane="xz")

    k = torch.tensor([0.5, 1.0, 2.0])
    for count in (2, 4):
        together = tb.modes(of(k), count=count)
        for i, stiffness in enumerate(k):
            alone = tb.modes(of(stiffness), count=count)
            assert_close(together.frequency[i], alone.frequency, rtol=1e-9, atol=0)
            assert_close(together.shape[i].abs(), alone.shape.abs(), rtol=0, atol=1e-6)
