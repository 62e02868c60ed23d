"""Loads on sites alone, without a beam: tangents, energies, power; and what each effect refuses."""

import math
from dataclasses import replace

import pytest
import torch
from torch.autograd import forward_ad
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.nodal_cases import inertia, spd
from tests.cases.site_loads import lag, lagged, user, wind
from torchbeam.core.leaves import bound, leaves
from torchbeam.math import quaternions as quat
from torchbeam.scene import effects as fx
from torchbeam.scene.effects.load_point import together

B, SITES = 2, 4
ZERO = torch.tensor(0.3)
BEAM = tb.Beam.straight(
    1.0, SITES - 1, tb.Section.from_stiffness(EA=1, GA=1, GJ=1, EI=1, mass=1, inertia=0.1)
)


def bind(effect):
    """As a scene has it: plain numbers are tensors."""
    return bound(effect, torch.get_default_dtype(), ZERO.device)


def effects():
    torch.manual_seed(3)
    six = 1 + torch.rand(B, 6)
    found = {
        "PointLoad follower": tb.PointLoad(
            1, force=torch.rand(B, 3), moment=torch.rand(3), follower=True
        ),
        "PointLoad follower moment": tb.PointLoad(1, moment=(1.0, 2, 3), follower=True),
        "LineLoad follower": tb.LineLoad(
            force=fx.Along(lambda s, t: torch.stack((s, s * t, 1 + 0 * s), -1)), follower=True
        ),
        "LineLoad of elements": tb.LineLoad(
            force=fx.PerElement(torch.rand(B, SITES, 3)), follower=True
        ),
        "Gravity": tb.Gravity(torch.rand(B, 3)),
        "MassDamping": fx.MassDamping(torch.rand(B)),
        "Drag": fx.Drag(1000.0, torch.rand(B), normal=1.1, tangential=0.1, flow=torch.rand(3)),
        "Drag in a flow": fx.Drag(1.0, 0.1, normal=torch.rand(B), tangential=0.3, flow=wind),
        "Spring": fx.Spring(-1, torch.rand(B), to=(0.1, 0.2, 0.3)),
        "Spring damped": fx.Spring(-1, 2.0, to=torch.rand(B, 3), damping=0.3),
        "Spring with a length": fx.Spring(-1, 2.0, to=(0.1, 0.2, 0.3), length=0.5),
        "Spring with a length, damped": fx.Spring(
            -1, 2.0, to=(0.1, 0.2, 0.3), length=0.5, damping=0.1
        ),
        "Spring on an arm": fx.Spring(1, 5.0, (0.1, 0.2, 0.3), offset=(0.02, -0.1, 0.3)),
        "Spring with a length on an arm": fx.Spring(
            1, 5.0, (0.1, 0.2, 0.3), 0.1, offset=(0.02, -0.1, 0.3)
        ),
        "Spring to a point that moves, damped": fx.Spring(
            -1, 2.0, to=lambda t: (t, t**2, 0.3), length=0.5, damping=0.1
        ),
        "RootSpring": fx.RootSpring(six),
        "RootSpring damped": fx.RootSpring((2.0, torch.rand(3)), damping=six),
        "Load": fx.Load(user, node=-1, inputs={"u": 3}),
        "Load along": fx.Load(user, node=None, inputs=[tb.Input("u", 3)]),
        "Load with a lag": fx.Load(
            lagged, node=-1, internal=2, rate=lag, of=("position", "rotation", "velocity")
        ),
    }
    return {name: bind(effect) for name, effect in found.items()}


NAMES = list(effects())
INPUTS = {"u": torch.tensor([0.1, -0.2, 0.3])}


def rotations(*shape):
    return quat.matrix(quat.normalize(torch.randn(*shape, 4)))


def a_site(effect, seed=0):
    """A random site with everything that an effect may read; masses with an offset and coupling."""
    torch.manual_seed(seed)
    lead = (B, SITES) if effect.node is None else (B,)
    support = fx.Pose(torch.randn(3), rotations(), torch.randn(3), torch.randn(3))
    R = rotations(*lead)
    if getattr(effect, "wants_support", False):  # turned by less than pi against the support
        R = support.R @ quat.matrix(quat.exponential(torch.randn(*lead, 3)))
    s = torch.tensor([0.0, 0.2, 0.7, 1.0]) if effect.node is None else None
    motion = (torch.randn(*lead, 3) for _ in range(3))
    by_element = isinstance(getattr(effect, "force", None), fx.PerElement)  # a site in each
    return fx.LoadPoint(
        R, spd(*lead), *motion, s, rotations(), support,
        torch.randn(*lead, getattr(effect, "internal", 0)), torch.tensor(0.4),
        elements=SITES - (not by_element),
        frame=(torch.randn(3), torch.randn(3)),
    )  # fmt: skip


def moved(site, name, by):
    """The site with one of what a wrench depends on changed by (..., 3), the rotation by a turn of
    `by` from the left.
    """
    if name == "rotation":
        return replace(site, R=quat.matrix(quat.exponential(by)) @ site.R)
    return replace(site, **{name: getattr(site, name) + by})


@pytest.mark.parametrize("name", NAMES)
def test_tangent(name):
    """Each tangent against central differences of the wrench, 1e-5 to either side: 1e-10 of
    truncation and of rounding; and against automatic differentiation, to rounding. It names what
    the wrench depends on, and nothing it depends on is missing.
    """
    effect = effects()[name]
    site = a_site(effect)
    lead = site.R.shape[:-2]
    tangent = effect.tangent(site, ZERO, INPUTS)
    assert set(tangent) == effect.depends
    automatic = fx.LoadEffect.tangent(effect, site, ZERO, INPUTS)
    for what in fx.load_point.READS:
        columns = []
        for i in range(3):
            by = 1e-5 * torch.eye(3)[i].expand(*lead, 3)
            ends = [
                together(effect.wrench(moved(site, what, sign * by), ZERO, INPUTS), site.R)
                for sign in (1, -1)
            ]
            columns.append((ends[0] - ends[1]) / 2e-5)
        differences = torch.stack(columns, -1)
        if what not in tangent:
            assert (differences == 0).all(), f"{name} depends on {what}"
            continue
        assert (differences != 0).any(), f"{name} does not depend on {what}"
        size = differences.abs().max()
        assert_close(
            tangent[what].expand_as(differences), differences, rtol=0, atol=1e-9 * float(size)
        )
        assert_close(
            automatic[what].expand_as(differences),
            tangent[what].expand_as(differences),
            rtol=0,
            atol=1e-12 * float(size),
        )


@pytest.mark.parametrize("name", ["Drag in a flow", "RootSpring damped", "Load", "Load with a lag"])
def test_tangent_where_derivatives_are_off_or_nested(name):
    """The tangent is the same under no_grad, within a forward derivative, within torch.func, and of
    one sample of a batch.
    """
    effect = effects()[name]
    site = a_site(effect)
    want = effect.tangent(site, ZERO, INPUTS)
    with torch.no_grad():
        off = effect.tangent(site, ZERO, INPUTS)
    with forward_ad.dual_level():
        dual = replace(
            site, position=forward_ad.make_dual(site.position, torch.ones_like(site.position))
        )
        within = effect.tangent(dual, ZERO, INPUTS)

    def of(position):
        return effect.tangent(replace(site, position=position), ZERO, INPUTS)[what].expand(
            *site.R.shape[:-2], 6, 3
        )

    for what in want:
        assert_close(off[what], want[what], rtol=0, atol=0)
        assert_close(forward_ad.unpack_dual(within[what]).primal, want[what], rtol=0, atol=0)
        _, slope = torch.func.jvp(of, (site.position,), (torch.ones_like(site.position),))
        near = [of(site.position + h) for h in (1e-5, -1e-5)]
        assert_close(
            slope, (near[0] - near[1]) / 2e-5, rtol=1e-7, atol=1e-7 * float(want[what].abs().max())
        )


def test_drag_at_rest():
    """No relative velocity: no force, no slope, no nan; the force is quadratic."""
    drag = bind(fx.Drag(2.0, 0.5, normal=1.2, tangential=0.1))
    site = replace(a_site(drag), velocity=torch.zeros(B, SITES, 3))
    assert (drag.wrench(site, ZERO, {})[0] == 0).all()
    for way in (drag.tangent, lambda *a: fx.LoadEffect.tangent(drag, *a)):
        assert all((d == 0).all() for d in way(site, ZERO, {}).values())
    site = a_site(drag)
    once, thrice = (
        drag.wrench(replace(site, velocity=k * site.velocity), ZERO, {})[0] for k in (1, 3)
    )
    assert_close(thrice, 9 * once)


def test_drag_by_hand():
    """A cylinder across and along a stream: 1/2 rho d C_n v^2 across, 1/2 rho pi d C_t v^2 along,
    against the motion.
    """
    drag = bind(fx.Drag(1000.0, 0.1, normal=1.2, tangential=0.02))
    site = fx.LoadPoint(torch.eye(3).expand(1, 3, 3), velocity=torch.tensor([[3.0, 0, 2.0]]))
    want = torch.tensor([[-0.5 * 1000 * math.pi * 0.1 * 0.02 * 9, 0, -0.5 * 1000 * 0.1 * 1.2 * 4]])
    assert_close(drag.wrench(site, ZERO, {})[0], want)


@pytest.mark.parametrize(
    "name",
    ["Drag", "MassDamping", "Spring damped", "Spring with a length, damped", "RootSpring damped"],
)
def test_what_dissipates_takes_energy(name):
    """Power of the wrench on the motion relative to what is at rest: never positive; with springs,
    less their energy's rate.
    """
    effect = effects()[name]
    for seed in range(20):
        site = a_site(effect, seed)
        velocity, spin = site.velocity, site.spin
        if name == "Drag":
            velocity = velocity - site.from_inertial(effect.flow)
        if name.startswith("Spring"):
            origin, omega = site.frame
            velocity = velocity - origin - torch.linalg.cross(omega.expand(B, 3), site.position)
        if name == "RootSpring damped":
            held = site.support
            velocity = (
                velocity
                - held.velocity
                - torch.linalg.cross(held.spin.expand(B, 3), site.position - held.position)
            )
            spin = spin - held.spin
        force, moment = (
            torch.zeros_like(velocity) if w is None else w for w in effect.wrench(site, ZERO, {})
        )
        if name.startswith(("Spring", "RootSpring")):
            elastic = bind(replace(effect, damping=None if "Root" in name else 0.0))
            quiet = elastic.wrench(site, ZERO, {})
            force, moment = force - quiet[0], moment - (0 if quiet[1] is None else quiet[1])
        power = (force * velocity).sum(-1) + (moment * spin).sum(-1)
        assert (power < 0).all()
        if name == "MassDamping":  # -alpha times twice the kinetic energy
            body = torch.cat(((site.R.mT @ velocity[..., None]), (site.R.mT @ spin[..., None])), -2)
            assert_close(power, -effect.alpha[:, None] * (body.mT @ site.mass @ body)[..., 0, 0])


@pytest.mark.parametrize("name", ["Spring", "Spring with a length", "RootSpring"])
def test_conservative_loads_come_from_an_energy(name):
    """Force and moment = -dU by displacement and spin; U by its definition: k (|d| - l)^2/2, and
    d^T k d/2 + phi^T k phi/2.
    """
    effect = effects()[name]
    site = a_site(effect)
    assert effect.conservative

    def energy(shift, spin):
        here = moved(moved(site, "position", shift), "rotation", spin)
        if name == "RootSpring":
            back = here.support.R.mT
            d = (back @ (here.position - here.support.position)[..., None])[..., 0]
            phi = quat.logarithm(quat.from_matrix(back @ here.R))
            return (effect.stiffness * torch.cat((d, phi), -1) ** 2).sum() / 2
        length = 0.0 if effect.length is None else torch.as_tensor(effect.length)
        stretch = (
            torch.linalg.vector_norm(here.position - torch.as_tensor(effect.to), dim=-1) - length
        )
        return (torch.as_tensor(effect.stiffness) * stretch**2).sum() / 2

    zero = torch.zeros(B, 3)
    by_r, by_spin = torch.func.grad(energy, (0, 1))(zero, zero)
    force, moment = effect.wrench(site, ZERO, {})
    assert_close(force, -by_r)
    assert_close(zero if moment is None else moment, -by_spin)


def test_moved_root_spring_at_rest():
    """At its support the spring is at rest: no load, and the tangent is -k, turned into frame a;
    nothing is nan.
    """
    spring = fx.RootSpring((torch.tensor([1.0, 2, 3]), torch.tensor([4.0, 5, 6])))
    R, r = rotations(), torch.randn(3)
    site = fx.LoadPoint(R, position=r, support=fx.Pose(r, R))
    assert_close(together(spring.wrench(site, ZERO, {}), R), torch.zeros(6), rtol=0, atol=1e-14)
    tangent = spring.tangent(site, ZERO, {})
    assert_close(tangent["position"][:3], -R @ torch.diag(torch.tensor([1.0, 2, 3])) @ R.T)
    assert_close(tangent["rotation"][3:], -R @ torch.diag(torch.tensor([4.0, 5, 6])) @ R.T)


def test_linear_lag_is_the_midpoint_rule():
    """z' = (u - z)/T: z_mid of the step solves z_mid = z + dt/2 (u - z_mid)/T exactly, also for
    dt = 1000 T.
    """
    T, u = 0.01, 2.0
    load = fx.Load(
        lambda x, R, v, w, t, z: (z, None), node=-1, internal=3,
        rate=lambda z, x, R, v, w, t: (u - z) / T, of=(),
    )  # fmt: skip
    for dt in (0.001, 10.0):
        z = torch.tensor([0.0, 1, 5])
        middle = load.advance(fx.LoadPoint(torch.eye(3)), z, ZERO, {}, torch.tensor(dt))
        assert_close(middle, (z + dt / 2 / T * u) / (1 + dt / 2 / T))


def test_line_load_of_elements_at_its_sites():
    """Each site has the load of its element; sites that lie otherwise are refused."""
    values = torch.randn(B, 3, 3)
    load = tb.LineLoad(force=fx.PerElement(values))
    for points in (1, 2):
        s = torch.linspace(0.1, 0.9, 3 * points)
        site = fx.LoadPoint(torch.eye(3).expand(3 * points, 3, 3), s=s, elements=3)
        force, _ = load.wrench(site, ZERO, {})
        assert_close(force, values.repeat_interleave(points, -2))
    nodes = fx.LoadPoint(torch.eye(3).expand(4, 3, 3), s=torch.linspace(0, 1, 4), elements=3)
    with pytest.raises(ValueError, match=r"4 sites .* 3 elements"):
        load.wrench(nodes, ZERO, {})


def test_actuation_by_elements():
    """Values, functions, inputs, a range of elements."""
    like, t = torch.zeros(1), torch.tensor(2.0)
    everywhere = bind(fx.Actuation(curvature=(0, 1.0, 2))).eigenstrain(t, {}, like, 4)
    assert_close(everywhere, torch.tensor([[0.0, 0, 0, 0, 1, 2]]))
    part = fx.Actuation(strain=lambda t: t * torch.ones(3), elements=range(1, 3)).eigenstrain(
        t, {}, like, 4
    )
    assert_close(part[:, :3], torch.tensor([0.0, 2, 2, 0])[:, None].expand(4, 3))
    given = fx.Actuation(curvature=tb.Input("k", 3), elements=slice(-1, None))
    assert_close(
        given.eigenstrain(t, {"k": torch.ones(B, 3)}, like, 4)[:, :, 4],
        torch.tensor([[0.0, 0, 0, 1]] * B),
    )
    each = fx.Actuation(curvature=fx.PerElement(torch.arange(12.0).reshape(4, 3))).eigenstrain(
        t, {}, like, 4
    )
    assert_close(each[:, 3:], torch.arange(12.0).reshape(4, 3))


def test_point_mass_both_ways():
    """A 6x6 mass about the node is the mass, offset and inertia that it was made of: parallel axes,
    J = J_c - m ~c ~c.
    """
    m, c, J = torch.rand(B) + 1, torch.randn(B, 3), inertia(spd(B, size=3))
    body = fx.PointMass(m, J, c)
    matrix = body.about_node
    v, w = torch.randn(3), torch.randn(3)
    there = v + torch.linalg.cross(w.expand(B, 3), c)
    energy = (m * there.square().sum(-1) + (w @ J * w).sum(-1)) / 2
    both = torch.cat((v, w))
    assert_close((both @ matrix * both).sum(-1) / 2, energy)
    again = fx.PointMass(matrix)
    assert_close(again.mass, m)
    assert_close(again.offset, c)
    assert_close(again.inertia, J)
    assert_close(
        bind(fx.PointMass(2.0, inertia=(1.0, 2, 3))).about_node,
        torch.diag(torch.tensor([2.0, 2, 2, 1, 2, 3])),
    )


def test_rayleigh():
    """ratio = alpha/(2 w) + tau w/2 at both frequencies."""
    mass, strain = fx.rayleigh((3.0, torch.tensor([20.0, 40.0])), (0.02, 0.03))
    for w, z in ((3.0, 0.02), (torch.tensor([20.0, 40.0]), 0.03)):
        assert_close(
            mass.alpha / (2 * w) + strain.tau * w / 2, torch.full((2,), z), rtol=1e-6, atol=0
        )


def test_rayleigh_of_numbers_takes_any_dtype():
    of = tb.Section.from_stiffness(EA=1.0, GA=1.0, GJ=1.0, EI=1.0, mass=1.0)
    effects = tb.rayleigh((3.0, torch.tensor(20.0, dtype=torch.float32)), (0.02, 0.03))
    for dtype in (torch.float32, torch.float64):
        scene = tb.Scene(tb.Beam.straight(1.0, 2, of), effects, dtype=dtype)
        assert {effect.value.dtype for effect in leaves(scene.effects)} == {dtype}


def test_rayleigh_of_modes():
    """The modes of a damped beam have the ratios wanted (to 1e-8 by lumped masses, as the dampings
    have them); of three ratios the fit is the nearest: what is left is orthogonal to what alpha and
    tau can do. Torsion has a tau of its own.
    """
    of = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=0.8, EI=(1.0, 2.0), mass=0.2, inertia=1e-4)
    beam = tb.Beam.straight(1.0, 6, of)
    w = tb.modes(tb.Scene(beam), count=3, lumped=True).frequency
    for n, ratio in ((2, (0.02, 0.02)), (3, (0.02, 0.01, 0.04))):
        found = tb.modes(
            tb.Scene(beam, tb.rayleigh(w[:n], ratio)), count=3, lumped=True
        ).damping_ratio[:n]
        left = found - torch.tensor(ratio)
        assert_close(left @ torch.stack((1 / w[:n], w[:n]), -1), torch.zeros(2), rtol=0, atol=1e-6)
        assert (left.abs().max() < 1e-8) == (n == 2)
    # a chain of 6: 2 c/h sin(h k/2), k = pi/2L
    twist = 2 * (0.8 / 2e-4) ** 0.5 * 6 * math.sin(math.pi / 24)
    damped = tb.modes(
        tb.Scene(beam, tb.Damping((0, 0, 0, 2 * 0.03 / twist, 0, 0))), count=12, lumped=True
    )
    nearest = (damped.frequency - twist).abs().argmin()
    assert_close(damped.damping_ratio[nearest].item(), 0.03, rtol=1e-3, atol=0)


REFUSED = {
    "rayleigh with equal frequencies": lambda: fx.rayleigh((3.0, 3.0), (0.02, 0.03)),
    "rayleigh with frequencies of shape (3,) and ratios of shape (2,)": lambda: fx.rayleigh(
        (3.0, 4.0, 5.0), (0.02, 0.03)
    ),
    "take a negative coefficient": lambda: fx.rayleigh((3.0, 4.0), (0.01, 0.1)),
    "Drag's flow of shape (2,)": lambda: fx.Drag(1.0, 0.1, flow=(1.0, 2.0)),
    "principal moment -1": lambda: fx.PointMass(1.0, inertia=(1.0, -1, 2)),
    "not symmetric": lambda: fx.PointMass(
        1.0, inertia=torch.eye(3) + torch.tensor([[0, 0.1, 0], [0, 0, 0], [0, 0, 0]])
    ),
    "no rigid body": lambda: fx.PointMass(torch.diag(torch.tensor([1.0, 2, 1, 1, 1, 1]))),
    "the matrix holds them": lambda: fx.PointMass(torch.eye(6), offset=(0, 0, 1.0)),
    "node = ('tip',)": lambda: fx.PointMass(1.0, node=("tip",)),
    "node = 0.5": lambda: fx.Spring(0.5, 1.0, to=(0, 0, 0)),
    "Spring's to of shape (2,)": lambda: fx.Spring(-1, 3.0, to=(0, 0)),
    "stiffness of shape (5,)": lambda: fx.RootSpring((1.0, 2, 3, 4, 5)),
    "neither curvature nor strain": lambda: fx.Actuation(),
    "Along the beam": lambda: fx.Actuation(curvature=fx.Along(lambda s, t: s)),
    "elements = (7,)": lambda: bind(fx.Actuation(curvature=(0, 0, 1.0), elements=7)).eigenstrain(
        ZERO, {}, ZERO, 4
    ),
    "only what acts along the beam": lambda: tb.TipLoad(force=fx.Along(lambda s, t: s)),
    "one of each element": lambda: tb.LineLoad(force=fx.PerElement(torch.zeros(7, 3))).wrench(
        fx.LoadPoint(torch.eye(3), s=torch.linspace(0, 1, 4), elements=3), ZERO, {}
    ),
    "Load's function = 1.0 was given; a function is wanted": lambda: fx.Load(1.0, node=-1),
    "internal states without a rate": lambda: fx.Load(user, node=-1, internal=2),
    "a rate without internal states": lambda: fx.Load(user, node=-1, rate=lag),
    "of = 'speed'": lambda: fx.Load(user, node=-1, of=("speed",)),
    "Load's inputs": lambda: fx.Load(user, node=-1, inputs=("u",)),
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_refusal(sentence):
    with pytest.raises(ValueError) as refusal:
        REFUSED[sentence]()
    assert sentence in str(refusal.value)


PARAMETERS = {
    "Drag": (lambda p: fx.Drag(p[0], p[1], normal=p[2], tangential=p[3], flow=p[4:]), 7),
    "MassDamping": (lambda p: fx.MassDamping(p[0]), 1),
    "Spring": (lambda p: fx.Spring(-1, p[0], to=p[1:4], length=p[4], damping=p[5]), 6),
    "RootSpring": (lambda p: fx.RootSpring(p[:6], damping=(p[6], p[7:])), 10),
    "LineLoad of elements": (
        lambda p: tb.LineLoad(force=fx.PerElement(p.reshape(SITES, 3)), follower=True),
        3 * SITES,
    ),
    "Load with a lag": (
        lambda p: fx.Load(lagged, node=-1, internal=2, rate=lambda z, *m: lag(z, *m) * p),
        2,
    ),
}


@pytest.mark.parametrize("name", PARAMETERS)
def test_gradient_by_parameters(name):
    """Wrench and tangent against central differences, by reverse and forward mode."""
    make, size = PARAMETERS[name]
    p = 0.5 + torch.rand(size)
    site = a_site(make(p))

    def found(p):
        effect = make(p)
        return together(effect.wrench(site, ZERO, {}), site.R), *effect.tangent(
            site, ZERO, {}
        ).values()

    assert torch.autograd.gradcheck(
        found, p.requires_grad_(), check_forward_ad=True, fast_mode=True
    )


@pytest.mark.parametrize("node", [-1, None])
def test_a_load_s_arguments_can_be_stacked(node):
    """State and inputs reach the function with the same number of axes, whichever has the batch."""
    seen = []

    def function(r, R, v, w, t, u):
        seen.append({x.ndim for x in (r, v, w, u)} | {R.ndim - 1})
        return torch.cat((v[..., :1] + u, v[..., 1:] + 0 * u), -1), None

    section = tb.Section.from_stiffness(EA=10.0, GA=4.0, GJ=0.5, EI=1.0, mass=0.3, inertia=0.01)
    scene = tb.Scene(
        tb.Beam.straight(1.0, 2, section), [tb.Load(function, node=node, inputs={"u": 1})]
    )
    stepper = tb.Stepper(scene, 0.1)
    for shape, u in (((), (2,)), ((2,), ()), ((3, 2), (2,)), ((), ())):
        stepper(tb.rest(scene, shape), u=torch.zeros(*u, 1))
    assert all(len(axes) == 1 for axes in seen)
