"""Frames, roots and supports that move or give way, and masses off their node: tangents, balances,
invariance, closed forms.
"""

import math
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.nodal_cases import energy_drifts, orders, scene, section, state
from tests.cases.tangent_cases import assert_newton_inverts
from torchbeam.equations.midpoint import MidpointProblem
from torchbeam.equations.steady import Configuration, SteadyProblem
from torchbeam.math import quaternions as quat
from torchbeam.nodal.discretise import discretise
from torchbeam.state.state_check import with_optional_fields

SECTION = tb.Section.from_stiffness(EA=1e3, GA=1e3, GJ=0.8, EI=(1.0, 1.2), mass=0.2, inertia=1e-3)
BEAM = tb.Beam.straight(1.0, 4, SECTION)
TURNING = tb.Frame(
    velocity=(0.3, -0.2, 0.1),
    angular_velocity=lambda t: torch.stack((1 + t, 0.5 - t, 2 * torch.cos(t))),
)
SHAKEN = tb.RootMotion(
    displacement=lambda t: torch.stack((0.1 * t, torch.sin(t), 0.2 * t**2)),
    rotation=lambda t: torch.stack((torch.sin(t), 0.3 * t, 0.5 * t)),
)
HINGED = (
    tb.Support(0, rotation="xz"),
    tb.Support(2, position="y", rotation=""),
    tb.Support(-1, position="xz", rotation=""),
)


def user(r, R, v, w, t):
    """A load that looks at everything."""
    return torch.sin(r) - 0.3 * v * v.norm(dim=-1, keepdim=True) + R[..., 0], torch.linalg.cross(
        w, r
    ) - 0.2 * w + R[..., 1]


def lagging(r, R, v, w, t, z):
    return z, None


def wake(r, R, v, w, t, z, s, chord):
    """A load along the beam of lags, place and a parameter."""
    moment = (1 + s[..., None]) * torch.linalg.cross(R[..., 0], z[..., :3])
    return z[..., :3] * chord[..., None] - R[..., 1] * z[..., 3:], moment


def wake_rate(z, r, R, v, w, t, s, chord):
    fast = (v * R[..., 2]).sum(-1, keepdim=True) + chord[..., None] * (w * R[..., 0]).sum(
        -1, keepdim=True
    )
    return torch.cat((v - 2 * z[..., :3], fast - z[..., 3:] * (1 + z[..., 3:] ** 2)), -1)


def heavy(r, R, v, w, t, acceleration, angular_acceleration):
    """A load of both accelerations, of none linear alone."""
    across = torch.linalg.cross(angular_acceleration, R[..., 0])
    moment = torch.linalg.cross(acceleration, R[..., 1])
    return -0.3 * acceleration - 0.2 * across * v.norm(dim=-1, keepdim=True), moment - across


INERTIAL = ("rotation", "velocity", "acceleration", "angular_acceleration")
# fmt: off
EXTRA = {
    "point mass": lambda: dict(extra=[tb.PointMass(0.4, inertia=(0.1, 0.2, 0.25),
                                                   offset=(0.1, -0.3, 0.2), node=2)]),
    "user load": lambda: dict(extra=[tb.Load(user, node=-1), tb.Load(user, node=None)]),
    "lag": lambda: dict(extra=[tb.Load(lagging, node=-1, internal=3, rate=lambda z, r, R, v, w,
                                       t: -2 * z + v)]),
    "lags along the beam": lambda: dict(frame=TURNING, extra=[tb.Load(
        wake, None, (), 4, wake_rate, ("rotation", "velocity", "spin", "s"),
        values={"chord": [1.0, 2, 3, 4]})]),
    "drag, mass damping": lambda: dict(extra=[tb.Drag(1.2, 0.4, tangential=0.1),
                                              tb.MassDamping(0.3)]),
    "added mass": lambda: dict(extra=[tb.Drag(1.2, 0.4, added_mass=0.8)]),
    "added mass in a frame": lambda: dict(frame=TURNING, extra=[tb.Drag(1.2, 0.4, added_mass=0.8)]),
    "accelerations": lambda: dict(extra=[tb.Load(heavy, node=-1, of=INERTIAL),
                                         tb.Load(heavy, of=INERTIAL, node=None)]),
    "accelerations and a mass off its node": lambda: dict(frame=TURNING, extra=[
        tb.PointMass(0.4, offset=(0.1, -0.3, 0.2)), tb.Load(heavy, of=INERTIAL, node=2),
        tb.Drag(1.2, 0.4, added_mass=0.8)]),
    "springs": lambda: dict(extra=[tb.Spring(3, 2.0, (1.0, 2, 3), length=0.5, damping=0.1)]),
    "root spring": lambda: dict(extra=[tb.RootSpring((torch.tensor([5.0, 6, 7]),
                                                      torch.tensor([2.0, 3, 4])), (0.1, 0.2))]),
    "frame": lambda: dict(frame=TURNING),
    "root": lambda: dict(root=SHAKEN),
    "supports": lambda: dict(supports=HINGED),
    "free": lambda: dict(supports=()),
    "actuated": lambda: dict(extra=[tb.Actuation(curvature=(0.3, 0.2, -0.4))]),
    "all": lambda: dict(frame=TURNING, root=SHAKEN, extra=[
        tb.PointMass(0.4, offset=(0.1, -0.3, 0.2)), tb.Load(user, node=-1), tb.Drag(1.2, 0.4),
        tb.MassDamping(0.3)]),
}
# fmt: on


def case(name, batch=(), damping="one"):
    more = EXTRA[name]()
    of = scene(batch=batch, damping=damping)
    freed = any(getattr(e, "frees_root", False) for e in more.get("extra", ()))
    return replace(
        of,
        effects=[*of.effects, *more.pop("extra", ())],
        **({"supports": ()} if freed else {}),
        **more,
    )


@pytest.mark.parametrize(
    "kind, name", [(k, n) for n in EXTRA for k in ("step", "still") if (k, n) != ("still", "free")]
)
def test_newton_update_inverts_the_derivative_of_the_residual(kind, name):
    """At a random iterate, with all that may act (rounding of a solve whose condition is about
    1e4).
    """
    of = case(name, batch=(3,))
    model = discretise(of)
    if kind == "still":
        s = state(of)
        problem = SteadyProblem(model, torch.tensor(0.3), {}, torch.full((3,), 0.7))
        x = problem.apply_supports(Configuration(s.position, s.rotation, s.stress))
    else:
        start = moving(of)
        problem = MidpointProblem(model, start, torch.tensor(0.1), torch.tensor(0.3), {})
        x = problem.predictor()
        torch.manual_seed(7)
        push = 0.2 * torch.randn(3, 5, 6) * model.constraints.moving
        x = problem.update(x, push, torch.randn_like(x.stress))
    size = problem.residual(x)[0].nodes.abs().max().item()
    assert_newton_inverts(problem, x, nodes=1e-10 * size, strain=1e-9)


def moving(of):
    """A random state of a scene, with its frame somewhere and internal states somehow."""
    found = with_optional_fields(state(of), of)
    if found.frame is not None:
        q = quat.normalize(torch.randn(3, 4))
        found = replace(found, frame=q)
    if found.internal is not None:
        found = replace(found, internal=torch.randn_like(found.internal))
    return found


def momenta(model, s):
    """P and L about frame a's origin (..., 3), frame a."""
    inertia = model.inertia
    v = inertia.centre_velocity(s.rotation, s.velocity, s.spin)
    p = inertia.translational.momentum(v)
    x = (
        s.position + inertia.offset.turned(s.rotation).offset
        if inertia.offset.present
        else s.position
    )
    return p.sum(-2), (
        torch.linalg.cross(x, p) + quat.rotate(s.rotation, inertia.rotary.section_momentum(s.spin))
    ).sum(-2)


@pytest.mark.parametrize("offset", [False, True])
def test_a_free_beam_keeps_momentum(offset):
    """Free, no loads, from a random state, a mass off its node or not: P and L stay, to 1e-11 over
    ten steps of 50 ms; the centre of mass moves on a straight line at P/m.
    """
    extra = (
        [tb.PointMass(0.7, inertia=(0.1, 0.2, 0.25), offset=(0.1, -0.3, 0.2), node=1)]
        if offset
        else []
    )
    of = tb.Scene(scene(effects=()).beam, extra, supports=())
    stepper, s = tb.Stepper(of, 0.05, tolerance=1e-13), state(scene(effects=()))
    s = replace(s, reaction=torch.zeros(0, 6))
    start = momenta(stepper.model, s)
    for _ in range(10):
        s = stepper(s)
    assert s.status == 0 and s.reaction.shape == (0, 6)
    for now, then in zip(momenta(stepper.model, s), start, strict=True):
        assert_close(now, then, rtol=0, atol=1e-11)


@pytest.mark.steps
def test_energy_with_an_eccentric_mass_is_second_order():
    """Undamped, dead load and weight: the energy balance closes but for the step's error, which
    falls by four as dt halves.
    """
    of = tb.Scene(
        BEAM,
        [
            tb.TipLoad(force=(0, 1.0, 2.0)),
            tb.Gravity((0, 0, -9.81)),
            tb.PointMass(0.3, inertia=(1e-3, 2e-3, 3e-3), offset=(0.05, 0.1, 0.03)),
        ],
    )
    drifts = energy_drifts(of, torch.linspace(0, 0.2, 3), (0.02, 0.01, 0.005), tolerance=1e-12)
    assert drifts[0] < 1e-3
    assert_close(orders(drifts), torch.full((2,), 2.0), rtol=0, atol=0.1)


def test_implicit_and_explicit_agree_with_an_eccentric_mass():
    """The midpoint step, lumped, tends to rk4 at 0.5 ms as dt^2: from 2 to 0.5 ms the distance
    falls by more than 10 (16 in the limit; fast modes are on their way there), to below 1e-5:
    offset section, offset point mass, a frame that turns.
    """
    M = torch.diag(torch.tensor([0.2, 0.2, 0.2, 3e-3, 2e-3, 2e-3]))
    e = quat.skew(torch.tensor([0.0, 0.03, 0.02]))
    M[3:, :3], M[:3, 3:] = 0.2 * e, -0.2 * e
    M[3:, 3:] += 0.2 * e.mT @ e
    beam = tb.Beam.straight(1.0, 2, tb.Section(SECTION.compliance, M))
    of = tb.Scene(
        beam,
        [
            tb.Gravity((0, 1.0, -9.81)),
            tb.PointMass(0.1, inertia=(1e-3, 1e-3, 1e-3), offset=(0, 0.1, 0.05)),
        ],
        frame=TURNING,
    )
    t = torch.tensor([0.0, 0.02])
    exact = tb.simulate(of, t, method="rk4", options={"step_size": 5e-4}).state[-1]
    ends = [
        tb.simulate(of, t, step=h, lumped=True, tolerance=1e-12).state[-1] for h in (2e-3, 5e-4)
    ]
    for name in ("position", "frame"):
        errors = [(getattr(s, name) - getattr(exact, name)).norm().item() for s in ends]
        assert errors[0] > 10 * errors[1] and errors[1] < 1e-5


def rotated(t):
    """Frame a's axes in inertial ones after angle 8 t^2 about z, (..., 3, 3)."""
    c, s, o = torch.cos(8 * t**2), torch.sin(8 * t**2), torch.zeros_like(t)
    return torch.stack(
        (torch.stack((c, -s, o), -1), torch.stack((s, c, o), -1), torch.stack((o, o, o + 1), -1)),
        -2,
    )


@pytest.mark.parametrize("method", ["midpoint", "rk4"])
def test_a_turning_frame_is_a_turning_root(method):
    """Spun up about z at 16 rad/s^2 under weight: seen from a frame that turns, and from one that
    does not while the clamp turns: the same positions, root forces and energy. They differ by the
    step's error, which falls as dt^2; explicit, by 1e-6.
    """
    gaps, weight = [], tb.Gravity((0.0, -3, -9.81))
    explicit = dict(method="rk4", options={"step_size": 1 / 600})
    steps = [dict(step=h) for h in (0.01, 0.005)] if method == "midpoint" else [explicit]
    t = torch.linspace(0, 0.1 if method == "midpoint" else 0.05, 3)
    for options in steps:
        frame = tb.Frame(angular_velocity=lambda t: torch.stack((0 * t, 0 * t, 16 * t)))
        root = tb.RootMotion(rotation=lambda t: torch.stack((0 * t, 0 * t, 8 * t**2)))
        seen, moved = (
            tb.simulate(tb.Scene(BEAM, [weight], **kind), t, **options)
            for kind in (dict(frame=frame), dict(root=root))
        )
        R = rotated(t)
        gaps.append(
            [
                (R @ a[..., None])[..., 0].sub(b).abs().max().item()
                for a, b in (
                    (seen.tip.position, moved.tip.position),
                    (seen.tip.velocity, moved.tip.velocity),
                    (seen.root.force, moved.root.force),
                )
            ]
        )
    assert max(gaps[-1]) < (0.02 if method == "midpoint" else 1e-4) and gaps[-1][0] < 5e-6
    if method == "midpoint":
        assert gaps[0][0] > 3.5 * gaps[1][0]


@pytest.mark.steps
def test_energy_balance_closes_with_a_moving_root():
    """Kinetic + strain = work of the weight and of the clamp, to the step's error: 1e-4 of the
    largest at 5 ms, and a quarter at half the step.
    """
    drifts = []
    for h in (0.01, 0.005):
        e = tb.simulate(
            tb.Scene(BEAM, [tb.Gravity((0, 0, -9.81))], root=SHAKEN),
            torch.linspace(0, 0.2, 3),
            step=h,
        ).energy
        drifts.append(
            ((e.kinetic - e.kinetic[0] + e.strain - e.work).abs().max() / e.kinetic.max()).item()
        )
    assert drifts[1] < 1e-3 and drifts[0] > 3 * drifts[1]


def test_an_accelerated_frame_is_gravity():
    """A frame that accelerates by a is the same as weight -a, to rounding, velocities less that of
    the frame.
    """
    seen = tb.simulate(
        tb.Scene(BEAM, frame=tb.Frame(velocity=lambda t: torch.stack((0 * t, 2 * t, -3 * t)))),
        torch.linspace(0, 0.2, 3),
        step=0.01,
        tolerance=1e-12,
    )
    heavy = tb.simulate(
        tb.Scene(BEAM, [tb.Gravity((0, -2.0, 3.0))]),
        torch.linspace(0, 0.2, 3),
        step=0.01,
        tolerance=1e-12,
    )
    assert_close(seen.nodes, heavy.nodes, rtol=0, atol=1e-12)
    assert_close(
        seen.tip.velocity[-1] - torch.tensor([0, 0.4, -0.6]),
        heavy.tip.velocity[-1],
        rtol=0,
        atol=1e-10,
    )


@pytest.mark.parametrize(
    "extra", [[], [tb.PointMass(0.2, inertia=(1e-3, 2e-3, 3e-3), offset=(0.02, 0.1, -0.05))]]
)
def test_steady_rotation_is_steady(extra):
    """The equilibrium in a frame that turns at 6 rad/s about a skew axis stays where it is in the
    implicit step: 20 steps of 20 ms, to 1e-9; and pulls at its root with the centripetal force of
    its masses.
    """
    omega = torch.tensor([1.0, 2.0, 5.0])
    of = tb.Scene(BEAM, extra, frame=tb.Frame(angular_velocity=omega))
    still = tb.equilibrium(of, tolerance=1e-12)
    stepper = tb.Stepper(of, 0.02, tolerance=1e-12)
    s = still
    for _ in range(20):
        s = stepper(s)
    for name in ("position", "rotation", "velocity", "spin", "stress", "reaction"):
        assert_close(getattr(s, name), getattr(still, name), rtol=0, atol=1e-9)
    model = stepper.model
    x = (
        still.position
        if not extra
        else still.position + model.inertia.offset.turned(still.rotation).offset
    )
    pull = torch.linalg.cross(omega.expand_as(x), torch.linalg.cross(omega.expand_as(x), x))
    assert_close(
        still.root.force, model.inertia.translational.momentum(pull).sum(-2), rtol=0, atol=1e-9
    )


def test_propped_cantilever():
    """Line load q on a beam clamped at the root and propped at the tip: the prop takes 3/8 q L, the
    clamp 5/8 q L and q L^2/8 (Euler-Bernoulli; shear moves 3 EI/(kGA L^2) = 0.3 % of that, 16
    elements 0.1 %).
    """
    beam = tb.Beam.straight(1.0, 16, SECTION)
    q = 1e-3
    s = tb.equilibrium(
        tb.Scene(
            beam,
            [tb.LineLoad(force=(0, 0, -q))],
            supports=(tb.Support(0), tb.Support(-1, rotation="")),
        )
    )
    prop, clamp = s.reaction_of(1), s.root
    assert_close(prop.force[2] / q, torch.tensor(3 / 8), rtol=5e-3, atol=0)
    assert_close(clamp.force[2] / q, torch.tensor(5 / 8), rtol=5e-3, atol=0)
    assert_close(clamp.moment[1] / q, torch.tensor(-1 / 8), rtol=2e-2, atol=0)
    assert_close(prop.moment, torch.zeros(3), rtol=0, atol=1e-12)
    assert_close(prop.force[:2] + clamp.force[:2], torch.zeros(2), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "ends, wanted",
    [
        ((tb.Support(0, rotation="xz"), tb.Support(-1, position="yz", rotation="xz")), math.pi),
        ((tb.Support(0), tb.Support(-1)), 4.730041),
        ((), 4.730041),
        ((tb.Support(0), tb.Support(-1, position="yz", rotation="xz")), 3.926602),
    ],
)
def test_frequencies_of_supported_beams(ends, wanted):
    """First bending frequency in the x-z plane k^2 sqrt(EI/m L^4): pinned k = pi, clamped and free
    4.730041, propped 3.926602 (Blevins 1979, table 8-1). 32 elements, slender (shear and rotary
    inertia 1e-5): 0.2 %.
    """
    of = tb.Section.from_stiffness(EA=1e6, GA=1e6, GJ=1e3, EI=(1.0, 1e3), mass=1.0, inertia=1e-7)
    scene = tb.Scene(tb.Beam.straight(1.0, 32, of), supports=ends)
    found = tb.modes(scene, tb.rest(scene), count=8).frequency
    flexible = found[found > 1.0]
    assert_close(flexible.min().sqrt(), torch.tensor(wanted), rtol=2e-3, atol=0)
    assert len(found) - len(flexible) == (6 if ends == () else 0)


def test_pendulum():
    """A stiff beam on a hinge falls from the horizontal: theta'' = 3 g cos(theta)/(2 L) (a rod; the
    discrete one has the inertia of its lumps, 1/4 N^2 of it more, halved by the coupling), at 0.3 s
    against that equation by rk4.
    """
    stiff = tb.Section.from_stiffness(EA=1e7, GA=1e7, GJ=1e5, EI=1e5, mass=0.2, inertia=0.0)
    of = tb.Scene(
        tb.Beam.straight(1.0, 16, stiff),
        [tb.Gravity((0, 0, -9.81))],
        supports=tb.Support(0, rotation="xz"),
    )
    tip = tb.simulate(of, torch.tensor([0.0, 0.3]), step=0.005).tip.position[-1]
    theta, omega, h = 0.0, 0.0, 1e-4
    for _ in range(3000):
        mid = omega + h / 2 * 14.715 * math.cos(theta), theta + h / 2 * omega
        theta, omega = theta + h * mid[0], omega + h * 14.715 * math.cos(mid[1])
    assert_close(tip, torch.tensor([math.cos(theta), 0, -math.sin(theta)]), rtol=0, atol=2e-3)


def test_a_support_that_moves():
    """The tip of a clamped beam is moved by its support: statics by the displacement, delta = F
    L^3/3 EI (1e-3 by shear and mesh), and a step puts it where it has to be.
    """
    lift = tb.Support(
        -1, position="z", rotation="", displacement=lambda t: torch.stack((0 * t, 0 * t, 1e-3 * t))
    )
    of = tb.Scene(
        tb.Beam.straight(1.0, 16, SECTION), [tb.Damping(0.1)], supports=(tb.Support(0), lift)
    )
    s = tb.equilibrium(of, t=1.0)
    assert_close(s.tip.position[2], torch.tensor(1e-3), rtol=0, atol=1e-15)
    assert_close(s.reaction_of(1).force[2], torch.tensor(3e-3), rtol=6e-3, atol=0)
    moved = tb.simulate(of, torch.linspace(0, 0.5, 3), step=0.01)
    assert_close(moved.tip.position[:, 2], 1e-3 * moved.t, rtol=0, atol=1e-15)


@pytest.mark.parametrize("held", ["frame", "root", "supports"])
def test_motions_given_as_lists_of_tensors(held):
    """[0, a, b] with tensors in it is the stacked tensor: the same motion, the same gradient, and
    the axes of a batch; plain numbers take the beam's precision.
    """

    def tip(motion, turn):
        given = {
            "frame": dict(frame=tb.Frame(velocity=motion, angular_velocity=turn)),
            "root": dict(root=tb.RootMotion(displacement=motion, rotation=turn)),
            "supports": dict(
                supports=(tb.Support(0), tb.Support(-1, displacement=motion, turn=turn))
            ),
        }[held]
        return tb.equilibrium(
            tb.Scene(tb.Beam.straight(1.0, 2, SECTION), [tb.Gravity((0, 0, -1.0))], **given)
        ).nodes[..., 1, :]

    batch = torch.tensor([0.1, 0.2])
    a, b = batch.clone().requires_grad_(), batch.clone().requires_grad_()
    listed = tip([0.0, a, 0.0], [0.0, 0.0, a])
    stacked = tip(torch.stack((0 * b, b, 0 * b), -1), torch.stack((0 * b, 0 * b, b), -1))
    assert listed.shape == (2, 3)
    assert_close(listed, stacked, rtol=0, atol=1e-12)
    mine, wanted = (torch.autograd.grad(x.sum(), y)[0] for x, y in ((listed, a), (stacked, b)))
    assert (wanted.abs() > 1e-6).all()
    assert_close(mine, wanted, rtol=1e-9, atol=0)
    assert tip([0.0, 0.1, 0.0], [0.0, 0.0, 0.1]).dtype == SECTION.compliance.dtype


def test_section_offset_is_a_shift_of_the_axis():
    """A beam described about an axis off its centre of mass and shear centre moves as the beam
    about the centre does: the points of the section are where they are. 20 steps under weight and a
    tip force at the centre, to the mesh's rounding of the coupling of neighbours
    (1e-3 of the motion).
    """
    shift = torch.tensor([0.0, 0.02, 0.03])
    shifted = section_about(shift)
    tips, load = [], torch.tensor([0.0, 0.5, 1.0])
    for of, e, root in ((SECTION, torch.zeros(3), shift), (shifted, shift, torch.zeros(3))):
        beam = tb.Beam.straight(1.0, 8, of, root=root)
        follow = tb.Load(
            lambda r, R, v, w, t, e=e: (load, torch.linalg.cross((R @ e), load)),
            node=-1,
            of=("rotation",),
        )
        s = tb.simulate(
            tb.Scene(beam, [follow, tb.Gravity((0, 0, -9.81))]),
            torch.linspace(0, 0.2, 3),
            step=0.01,
        ).state[-1]
        tips.append(s.tip.position + s.tip.rotation @ e)
    assert_close(tips[1], tips[0], rtol=0, atol=2e-4)


def section_about(e):
    """SECTION about an axis from which its centre is at e: [gamma; kappa] of the centre = T
    [gamma; kappa].
    """
    T = torch.eye(6)
    T[:3, 3:] = -quat.skew(e)
    K, M = torch.linalg.inv(SECTION.compliance), SECTION.mass
    return tb.Section(torch.linalg.inv(T.mT @ K @ T), T.mT @ M @ T)


def test_random_section_of_the_tests_has_no_offset():
    assert not section().offset
