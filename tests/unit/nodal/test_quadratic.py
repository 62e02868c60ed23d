"""Elements of three nodes: tangents = directional derivatives, objectivity, assembly; planes,
effects, gradients, sensors.

Orders of statics: tests/verification/test_statics.py; the tangent of a whole step, its momentum:
tests/unit/dynamics.
"""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from studies.common_case import Case
from tests.cases.nodal_cases import orders, shape
from torchbeam.dynamics.simulate import simulate
from torchbeam.math import quaternions as quat
from torchbeam.math.element_shapes import at_points, threes
from torchbeam.nodal.assembly import Assembly
from torchbeam.nodal.conditions import conditions
from torchbeam.nodal.coordinates.planar import Planar
from torchbeam.nodal.coordinates.spatial import Spatial
from torchbeam.nodal.discretise import discretise
from torchbeam.nodal.loads import Nodes, external
from torchbeam.scene.stations import STATIONS
from torchbeam.topology.framework import Framework

N, BATCH = 2, (5,)
ROUNDING = dict(rtol=0, atol=1e-12)
SECTION = tb.Section.from_stiffness(
    EA=100.0, GA=(60.0, 50.0), GJ=0.8, EI=(1.0, 1.5), mass=0.2, inertia=(1e-3, 2e-3)
)


def straight(**given):
    return tb.Beam.straight(
        1.0, given.pop("elements", N), given.pop("section", SECTION), order=2, **given
    )


def chain(space):
    return Assembly(Framework(2, (N,)), space.interpolation, space.dims.position)


def element(kind):
    """The space, positions and rotations of 2 N + 1 nodes, some quaternions of the other sign,
    lengths, stress and a move.
    """
    torch.manual_seed(3)
    nodes = 2 * N + 1
    length = 0.5 + torch.rand(*BATCH, 2 * N, 1)
    signs = torch.where(torch.rand(*BATCH, nodes, 1) < 0.5, -1.0, 1.0)
    if kind == "space":
        space, (position, rotation) = Spatial(order=2), shape(nodes, BATCH)
    else:
        space = Planar("xy", torch.eye(3), torch.eye(3), torch.tensor(0.0), order=2)
        position = torch.randn(*BATCH, nodes, 2)
        rotation = space.exponential(0.4 * torch.randn(*BATCH, nodes, 1))
    return (
        space, position, signs * rotation, length, torch.randn(*BATCH, 2 * N, space.dims.strain),
        torch.randn(*BATCH, nodes, space.unknowns),
    )  # fmt: skip


@pytest.mark.parametrize("kind", ["space", "plane"])
def test_local_functions_are_derivatives_of_each_other(kind):
    """B of the strain and K of the forces against forward mode, forces = h B^T [F; M], and the
    chain's assembly: moves to stations, forces to nodes and blocks are one linear map and its
    transpose.
    """
    space, position, rotation, length, stress, move = element(kind)
    p = space.dims.position

    def along(function):
        def moved(m):
            q = space.multiply(space.exponential(m[..., p:]), rotation)
            return function(space.kinematics(*chain(space).poses(position + m[..., :p], q), length))

        return torch.func.jvp(moved, (torch.zeros_like(move),), (move,))[1]

    kin = space.kinematics(*chain(space).poses(position, rotation), length)
    numbers = chain(space).to_elements(move)
    B, K = space.strain_operator(kin, length), space.geometric_stiffness(kin, stress, length)
    forces = space.forces(kin, stress, length)
    assert_close(
        (B @ numbers[..., None])[..., 0], along(lambda kin: space.strains(kin, length)), **ROUNDING
    )
    assert_close(
        (K @ numbers[..., None])[..., 0],
        along(lambda kin: space.forces(kin, stress, length)),
        **ROUNDING,
    )
    assert_close(forces, (length[..., None] * B.mT @ stress[..., None])[..., 0], **ROUNDING)
    assert_close(
        (chain(space).to_nodes(forces) * move).sum((-1, -2)),
        (forces * numbers).sum((-1, -2)),
        **ROUNDING,
    )
    matrix = chain(space).to_matrix(K)
    assert_close(
        matrix.times(move),
        (matrix.dense() @ move.flatten(-2)[..., None])[..., 0].view_as(move),
        **ROUNDING,
    )
    assert_close(
        matrix.times(move), chain(space).to_nodes((K @ numbers[..., None])[..., 0]), **ROUNDING
    )


def test_strains_are_objective():
    """Every node moved and turned by one rotation: the same strains to rounding."""
    space, position, rotation, length, *_ = element("space")
    turn = quat.normalize(torch.randn(*BATCH, 1, 4))

    def strain(r, q):
        return space.strains(space.kinematics(*chain(space).poses(r, q), length), length)

    turned = strain(quat.rotate(turn, position) + 1.0, quat.multiply(turn, rotation))
    assert_close(turned, strain(position, rotation), **ROUNDING)


@pytest.mark.parametrize("what", ["loads", "turning frame", "moving support"])
def test_plane_is_3d(what):
    """Three steps of 10 ms of a bent beam, in the plane and in 3D, and its frequencies there: agree
    to 1e-10.
    """
    beam = tb.Beam.arc(0.8, 1.2, N, SECTION, order=2)
    effects = [
        tb.TipLoad(force=(0.5, 2.0, 0), moment=(0, 0, 0.4), follower=True),
        tb.Gravity((0, -9.81, 0)),
        tb.Damping((0.01, 0.02, 0.03, 0.04, 0.05, 0.06)),
        tb.Drag(1.2, 0.05),
        tb.PointMass(0.1, inertia=(1e-3, 2e-3, 3e-3), offset=(0.05, 0.1, 0), node=1),
    ]
    more = {
        "loads": {},
        "turning frame": dict(
            frame=tb.Frame(angular_velocity=lambda t: t * torch.tensor((0, 0, 3.0)))
        ),
        "moving support": dict(
            supports=(
                tb.Support(0),
                tb.Support(
                    3,
                    rotation="",
                    displacement=lambda t: torch.stack((0 * t, torch.sin(9 * t) / 20, 0 * t)),
                ),
            )
        ),
    }[what]
    ends = []
    for plane in (None, "xy"):
        stepper = tb.Stepper(tb.Scene(beam, effects, plane=plane, **more), 0.01, tolerance=1e-13)
        assert isinstance(stepper.model.space, Planar) == (plane == "xy")
        state = stepper.rest()
        for _ in range(3):
            state = stepper(state)
        assert state.status == 0
        ends.append(state)
    for name in ("position", "rotation", "velocity", "spin", "stress", "work"):
        whole, flat = (getattr(s, name) for s in ends)
        assert_close(flat, whole, rtol=0, atol=1e-10 * max(1.0, whole.abs().max().item()))


def test_small_is_the_limit_of_3d():
    """Under loads of size s on an arc: the difference to 3D, relative to s, is of first order in
    s.
    """
    beam, gaps = tb.Beam.arc(0.8, 1.2, N, SECTION, order=2), []
    for s in (1e-2, 1e-3):
        effects = [
            tb.TipLoad(force=(0.3 * s, 2.0 * s, s), moment=(0.1 * s, 0, 0.2 * s)),
            tb.Gravity((0, 0, s)),
        ]
        one, other = (
            tb.equilibrium(tb.Scene(beam, effects, small=small)) for small in (True, False)
        )
        gaps.append((one.position - other.position).abs().max() / s)
    assert gaps[1] < 0.11 * gaps[0]


def test_bending_frequencies_are_of_sixth_order():
    """Second and third of an unshearable cantilever without rotary inertia, (beta L)^2 with cos x
    cosh x = -1: halving the elements from 4 to 8 divides their errors by 2^5.6 and more; eight
    leave 5.1e-6 and 1.0e-4. (Linear ones: 4e-3 and 1.5e-2.)
    """
    section = tb.Section.from_stiffness(EA=math.inf, GA=math.inf, GJ=1.0, EI=1.0, mass=1.0)
    exact = torch.tensor([4.694091132974175, 7.854757438237613]) ** 2
    scenes = (tb.Scene(straight(elements=n, section=section), plane="xy") for n in (4, 8))
    errors = torch.stack(
        [(tb.modes(scene, count=3).frequency[1:] / exact - 1).abs() for scene in scenes]
    )
    assert (orders(errors) > 5.6).all() and (errors[1] < 1.1e-4).all()


def test_common_dynamic_case():
    """Its first 0.15 s by three planar elements in steps of 5 ms: within 0.7 % of the reference
    (0.38 % over the whole 2 s, where eight linear elements leave 1.3 %).
    """
    case = Case.load()
    scene = case.scene(3, "xy", element="order 2")
    with torch.no_grad():
        assert case.error(simulate(scene, case.t[:16], step=0.005)) < 7e-3


def test_gradients_through_a_step_and_an_equilibrium():
    """By stiffness, length, load and a point mass off its node along one direction: forward mode,
    reverse mode and a central difference (1e-7: squares of a step of 1e-4).
    """

    def outcome(EI, length, force, mass):
        of = tb.Section.from_stiffness(EA=100.0, GA=50.0, GJ=0.8, EI=EI, mass=0.2, inertia=1e-3)
        scene = tb.Scene(
            tb.Beam.straight(length, 1, of, order=2),
            [
                tb.TipLoad(force=force, follower=True),
                tb.PointMass(mass, offset=(0.0, 0.1, 0.05), node=1),
            ],
        )
        stepper = tb.Stepper(scene, 0.05, tolerance=1e-13)
        state, still = stepper(stepper.rest()), tb.equilibrium(scene, tolerance=1e-13)
        return torch.cat(
            (state.tip.position, state.root.moment, still.stress[-1], still.root.force)
        )

    values, way = (
        [torch.tensor(v) for v in x]
        for x in ((1.0, 1.0, (0.1, 0.4, 1.0), 0.3), (0.3, -0.5, (0.2, 0.1, -0.3), 0.4))
    )
    ahead, behind = (
        outcome(*(v + sign * w for v, w in zip(values, way, strict=True))) for sign in (1e-4, -1e-4)
    )
    forward = torch.func.jvp(outcome, tuple(values), tuple(way))[1]
    weights = torch.arange(1.0, len(forward) + 1)
    asked = [v.requires_grad_() for v in values]
    backward = torch.autograd.grad((weights * outcome(*asked)).sum(), asked)
    assert_close(forward, (ahead - behind) / 2e-4, rtol=0, atol=1e-7)
    assert_close(
        sum((g * w).sum() for g, w in zip(backward, way, strict=True)),
        (weights * forward).sum(),
        rtol=0,
        atol=1e-9,
    )


def test_sensors_read_the_stations():
    """An end force on an elastic cantilever: bending falls evenly, and the readings of strain,
    stress and an element are right between the stations; a value for each element, and a section
    for each, count for its two stations.
    """
    beam, load = straight(elements=3), tb.TipLoad(force=(0, 0, 1e-6))
    state = tb.equilibrium(tb.Scene(beam, [load]))
    s = torch.tensor([0.0, 0.1, 0.5, 1.0])
    moment = -1e-6 * (1 - s)
    assert_close(tb.sensors.Stress(s, beam)(state)[:, 4], moment, rtol=1e-5, atol=1e-12)
    assert_close(tb.sensors.Curvature(s, beam)(state)[:, 1], moment / 1.0, rtol=1e-5, atol=1e-12)
    assert_close(
        tb.sensors.Curvature(beam=beam, element=1)(state)[1],
        torch.tensor(-0.5e-6),
        rtol=1e-5,
        atol=0,
    )
    assert state.stress.shape == (6, 6) and beam.station_axes(state.rotation).shape == (6, 4)
    each = tb.PerElement(torch.tensor([[0.0, 0, 1], [0, 0, 2], [0, 0, 4]]))
    bent = tb.equilibrium(tb.Scene(beam, [tb.LineLoad(force=each), tb.Actuation(curvature=each)]))
    assert_close(bent.root.force[2], torch.tensor(-7.0 / 3), rtol=1e-9, atol=0)
    with pytest.raises(ValueError, match=r"\(..., 3, 3\) is wanted"):
        tb.Scene(beam, [tb.LineLoad(force=tb.PerElement(torch.ones(6, 3)))])


def test_a_taper_is_taken_at_the_stations():
    """Tip deflection of a wedge whose EI falls linearly to a third, by two elements within 1e-3 of
    the closed form P L^3/(EI c^3) (c^2/2 + ... ), here by quadrature of x^2/(EI(x)); its mass is
    exact.
    """

    def section(s):
        k = 1 - 2 * s / 3
        return tb.Section.from_stiffness(EA=1e4 * k, GA=1e4 * k, GJ=k, EI=k, mass=k, inertia=1e-3)

    x = (torch.arange(10000) + 0.5) / 1e4
    deflection = ((1 - x) ** 2 / (1 - 2 * x / 3)).mean() + (1 / (1e4 * (1 - 2 * x / 3))).mean()
    scene = tb.Scene(straight(section=section), [tb.TipLoad(force=(0, 0, 1e-5))], small=True)
    assert_close(tb.equilibrium(scene).tip.position[2] * 1e5, deflection, rtol=1e-3, atol=0)
    weight = tb.equilibrium(tb.Scene(scene.beam, [tb.Gravity((0, 0, -1.0))], small=True)).root
    assert_close(weight.force[2], torch.tensor(2.0 / 3), rtol=1e-12, atol=0)
    assert_close(weight.moment[1], -torch.tensor(0.5 - 2.0 / 9), rtol=1e-12, atol=0)


def test_what_does_not_take_them_says_so():
    scene = tb.Scene(straight())
    with pytest.raises(ValueError, match="order = 3 was given; 1 or 2 is wanted"):
        tb.Beam.straight(1.0, 2, SECTION, order=3)
    with pytest.raises(ValueError, match="4 nodes were given to elements of order 2"):
        tb.Beam.from_nodes(torch.eye(3)[:1] * torch.arange(4.0)[:, None], SECTION, order=2)
    steep = straight(
        section=lambda s: tb.Section.from_stiffness(
            EA=1.0, GA=1.0, GJ=1.0, EI=1.0, mass=torch.exp(9 * s)
        )
    )
    with pytest.raises(ValueError, match="changes more than threefold within an element"):
        tb.equilibrium(tb.Scene(steep))
    with pytest.raises(ValueError, match="elements of order 2"):
        tb.simulate(scene, [0.0, 0.1], form="minimal", method="rk4", options={"step_size": 0.1})
    assert "elements of order 2" in str(tb.describe(scene)) and "2 elements of order 2" in repr(
        scene
    )


def test_places_and_loads_where_midside_nodes_are_off_the_middle():
    """Nodes at s of unequal intervals: the model has them there, as the beam is straight; a force
    per length that is linear in s, and one by element, load the beam by their integrals, to
    rounding.
    """
    s = torch.tensor([0, 0.19, 0.4, 0.57, 0.7, 0.9, 1.1])
    section = tb.Section.from_stiffness(EA=1.0, GA=1.0, GJ=1.0, EI=1.0, mass=1.0)
    beam = tb.Beam.from_nodes(torch.stack((s, 0 * s, 0 * s), -1), section, order=2)
    q, each = torch.tensor([0.0, 2, 3]), torch.tensor([0.3, 0.8, 0.1])
    by_place, by_element = tb.Along(lambda s, t: s[..., None] * q), tb.PerElement(each[:, None] * q)
    for force, total in ((by_place, 1.1**2 / 2), (by_element, (each * s[::2].diff()).sum())):
        model = discretise(tb.Scene(beam, [tb.LineLoad(force=force)]))
        assert_close(model.s, s)
        load = external(
            model, Nodes(beam.nodes, beam.frames), conditions(model, torch.tensor(0.0), {})
        )
        assert_close(load[:, :3].sum(0), total * q)
    values, _ = at_points(s)
    assert_close(
        STATIONS[2].places(beam.length),
        (values @ torch.stack(threes(s, 0), -1)[..., None])[..., 0].flatten(),
    )


@pytest.mark.parametrize("twist", [1.0, 3.0])
def test_a_section_that_is_the_same_everywhere_gives_each_node_its_own_inertia(twist):
    """However much the beam is twisted at rest: a station that is turned by an angle against a node
    would leave it a negative moment, where one of the section's is 64 times the other. Each node
    then has J times its share 1/6, 2/3, 1/6 of the element, in axes that are its own but for what
    interpolation leaves, a few 1e-3 rad: the principal moments are compared, at the nodes of one
    element alone.
    """
    section = tb.Section.from_stiffness(
        EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2, inertia=(1e-3, 1e-3 / 64)
    )
    J = discretise(
        tb.Scene(tb.Beam.straight(1.0, 2, section, twist=twist, order=2))
    ).inertia.rotary.J
    share = torch.tensor([1.0, 4.0, 2.0, 4.0, 1.0]) / 12
    own = torch.linalg.eigvalsh(section.mass[3:, 3:])
    alone = [0, 1, 3, 4]
    assert_close(torch.linalg.eigvalsh(J)[alone], (share[:, None] * own)[alone], rtol=0, atol=1e-15)
