"""`StripAir`: each section against closed forms of thin aerofoil theory, wings against theirs."""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from studies.verification import wing
from tests.cases.refusals import refusals
from torchbeam.extend import LoadEffect, LoadPoint
from torchbeam.extend import quaternions as quat

LAGS = dict(wagner=((0.165, 0.0455), (0.335, 0.3)), kussner=((0.5, 0.13), (0.5, 1.0)))
RHO, CHORD, AXIS, U = 1.2, 0.8, 0.35, 20.0
B, A = CHORD / 2, 2 * AXIS - 1
AHEAD = torch.tensor([0.0, -U, 0.0])
SHARES, RATES = torch.tensor([0.165, 0.335]), torch.tensor([0.0455, 0.3])  # Jones 1940
SECTION = tb.Section.from_stiffness(EA=1e7, GA=1e7, GJ=5e3, EI=(3e3, 1e6), mass=2.0, inertia=0.1)
STIFF = tb.Section.from_stiffness(EA=1e8, GA=1e8, GJ=50.0, EI=(1e7, 1e7), mass=2.0, inertia=0.1)


def air(chord=CHORD, axis=AXIS, wind=AHEAD, **more):
    return tb.StripAir(chord, axis=axis, density=RHO, wind=wind, **more)


def point(R, velocity, spin, **more):
    """One site."""
    site = dict(R=R, velocity=velocity, spin=spin, **more)
    return LoadPoint(**{name: x[None] for name, x in site.items()}, s=torch.zeros(1), elements=1)


def theodorsen(k):
    """C(k) = H1/(H1 + i H0), Hankel functions of the second kind (Theodorsen 1935)."""
    H1, H0 = (
        torch.complex(j(k), -y(k))
        for j, y in (
            (torch.special.bessel_j1, torch.special.bessel_y1),
            (torch.special.bessel_j0, torch.special.bessel_y0),
        )
    )
    return H1 / (H1 + 1j * H0)


def jones(k):
    """Transform of Wagner's function as Jones has it, (...) of k (...)."""
    s = 1j * k[..., None]
    return 1 - (SHARES * s / (s + RATES)).sum(-1)


@pytest.mark.parametrize("k", [0.05, 0.3, 1.0])
def test_harmonic_motion(k):
    """Plunge h and pitch theta as exp(i omega t), k = omega b/U: lift and moment about the axis are
    Theodorsen's with the two lags' own C(k) to rounding and the square of the amplitude, 1e-8; his
    function itself differs from it by 2.1 % at most (known of Jones's fit).
    """
    omega = k * U / B
    (load,) = tb.Scene(tb.Beam.straight(1.0, 1, SECTION), [air()]).effects
    h, theta = 1e-7 * torch.tensor([B + 0j, (0.3 - 0.8j)])
    C = jones(torch.tensor(k))
    assert (C - theodorsen(torch.tensor(k))).abs() < 2.1e-2
    w, p = -1j * omega * h + U * theta, 1j * omega * theta
    q = w + B * (0.5 - A) * p
    apparent, circulation = math.pi * RHO * B**2, 2 * math.pi * RHO * U * B * C * q
    rise = omega**2 * h + U * p + B * A * omega**2 * theta
    lift = apparent * rise + circulation
    moment = B * (A + 0.5) * circulation + apparent * (
        B * A * rise - B * U / 2 * p + B**2 / 8 * omega**2 * theta
    )
    delayed = q * RATES / (RATES + 1j * k)
    for phase in (0.0, 0.9, 2.2):
        turn = torch.tensor(1j * phase).exp()

        def at(x, turn=turn):
            return (x * turn).real

        still = torch.zeros(3)
        along, up = torch.tensor([1.0, 0, 0]), torch.tensor([0.0, 0, 1])
        site = point(
            quat.matrix(quat.exponential(at(theta) * along)),
            up * at(1j * omega * h), along * at(p), internal=at(delayed),
            acceleration=up * at(-(omega**2) * h),
            angular_acceleration=along * at(-(omega**2) * theta),
        )  # fmt: skip
        force, turning = load.wrench(site, still[0], {})
        assert_close(force[0, 2], at(lift), rtol=0, atol=1e-6 * lift.abs().item())
        assert_close(turning[0, 0], at(moment), rtol=0, atol=1e-6 * moment.abs().item())
        rate = load.rates(site, site.internal, still[0], {})[0]
        size = delayed.abs().amax().item() * omega
        assert_close(rate, at(1j * omega * delayed), rtol=0, atol=1e-6 * size)


def shear(x, t):
    return torch.sin(x) * 3 + torch.tensor([0.0, -5.0, 1.0])


@pytest.mark.parametrize("wind", [None, (1.0, -8.0, 2.0), shear], ids=["still", "steady", "shear"])
@pytest.mark.parametrize("lags", [None, "wagner"])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_tangent(lags, wind, side):
    """As automatic differentiation has it, at three sites in four random motions; chord tapered."""
    beam, draw = tb.Beam.straight(1.0, 2, SECTION), torch.Generator().manual_seed(0)
    load = tb.StripAir(side * torch.tensor([0.5, 0.6, 0.7]), axis=0.35, lags=lags, wind=wind)
    (load,) = tb.Scene(beam, [load]).effects

    def random(*shape):
        return torch.randn(4, 3, *shape, generator=draw)

    vectors = "position velocity spin acceleration angular_acceleration".split()
    site = LoadPoint(
        quat.matrix(quat.normalize(random(4))), **{name: random(3) for name in vectors},
        internal=random(2) if lags else None, s=torch.linspace(0, 1, 3), elements=2,
        dt=torch.tensor(0.01),
    )  # fmt: skip
    t = torch.tensor(0.3)
    wanted = LoadEffect.tangent(load, site, t, {})
    found = load.tangent(site, t, {})
    assert found.keys() == wanted.keys()
    for name, value in wanted.items():
        assert_close(found[name], value, rtol=0, atol=1e-12 * value.abs().max().item())


@pytest.mark.parametrize("lags", LAGS)
def test_sudden_incidence(lags):
    """A rigid wing that air meets at once, at 4 degrees: circulatory lift over the steady one is
    Wagner's function, 1 - 0.165 exp(-0.0455 s) - 0.335 exp(-0.3 s), s = U t/b semichords; or
    Kuessner's, 1 - exp(-0.13 s)/2 - exp(-s)/2. Lift is the mean over a step, of 0.1 semichord: off
    by the square of that, 5e-5 and 1e-3.
    """
    step, alpha, bound = 0.1 * B / U, math.radians(4.0), dict(wagner=5e-5, kussner=1e-3)[lags]
    wind = U * torch.tensor([0.0, -math.cos(alpha), math.sin(alpha)])
    held = [tb.Support(0), tb.Support(-1)]
    scene = tb.Scene(tb.Beam.straight(1.0, 1, SECTION), [air(wind=wind, lags=lags)], supports=held)
    run = tb.simulate(scene, step * torch.arange(81), step=step, engine="eager")
    lift = -run.state.reaction[1:, :, 2].sum(-1)
    s = 0.1 * (torch.arange(80) + 0.5)
    shares, rates = torch.tensor(LAGS[lags]).T
    wanted = 1 - (shares * torch.exp(-rates * s[:, None])).sum(-1)
    steady = math.pi * RHO * CHORD * U**2 * math.sin(alpha) * math.cos(alpha)
    assert_close(lift / steady, wanted, rtol=0, atol=bound)


def test_apparent_mass():
    """In still air a beam carries pi rho b^2 per length across the chord, and turns pi rho b^4/8
    about mid-chord: its frequencies fall by the roots of the masses. In torsion to 1e-9, as both
    are of the nodes; in bending to 1e-3 of 8 elements, whose own mass is spread, that of air not.
    """
    mass = math.pi * RHO * B**2

    def frequencies(GJ, *effects):
        section = tb.Section.from_stiffness(1e7, 1e7, GJ, (3e3, 1e6), 2.0, inertia=(1e-9, 0.2))
        beam = tb.Beam.straight(4.0, 8, section)
        return tb.modes(tb.Scene(beam, effects), count=1).frequency[0]

    still = air(axis=0.5, wind=None, lags=())
    ratio = frequencies(5.0, still) / frequencies(5.0)
    turning = (0.2 / (0.2 + mass * B**2 / 8)) ** 0.5
    assert_close(ratio, torch.tensor(turning), rtol=1e-9, atol=0)
    ratio = frequencies(5e3, still) / frequencies(5e3)
    assert_close(ratio, torch.tensor((2.0 / (2.0 + mass)) ** 0.5), rtol=1e-3, atol=0)


def test_divergence():
    """A straight wing twists by alpha (1/cos(k L) - 1) at its tip, k^2 = e c a q/GJ, and diverges
    at q = (pi/2L)^2 GJ/(e c a) (Bisplinghoff, Ashley and Halfman 1955, 8-2). Nodes bear the air of
    the length about them: k h/2 is replaced by its sine, exact for small angles (1e-4 rad: 1e-7).
    """
    N, L, e = 6, 3.0, (AXIS - 0.25) * CHORD
    beam = tb.Beam.straight(L, N, STIFF)
    half = math.pi / (4 * N)
    q = (math.pi / 2 / L) ** 2 * 50.0 / (e * CHORD * 2 * math.pi) * (math.sin(half) / half) ** 2
    speed = math.sqrt(2 * q / RHO)
    blown = tb.Scene(beam, [air(wind=tb.Input("wind", 3))])
    critical = tb.critical_load(
        blown, 1.3 * speed, lowest=0.7 * speed, points=4, inputs={"wind": (0, -1.0, 0)}
    )
    assert critical.divergence
    assert_close(critical.factor, torch.tensor(speed), rtol=1e-6, atol=0)
    alpha, share = 1e-4, 0.6
    wind = speed * share**0.5 * torch.tensor([0.0, -1.0, alpha])
    twist = tb.equilibrium(tb.Scene(beam, [air(wind=wind)])).tip.rotation[2, 1]
    k = 2 * math.asin(math.sin(half) * share**0.5)  # of an element
    assert_close(twist / alpha, torch.tensor(1 / math.cos(k * N) - 1), rtol=1e-5, atol=0)


M, S, I, KH, KT = 3.0, -0.15, 0.12, 900.0, 60.0  # per metre: kg, kg m, kg m; N/m^2, N


def typical(speed, **lags):
    """A rigid wing of 1 m that plunges on springs and turns about its axis, centre of mass behind:
    nodes at its ends, which bear half of it each.
    """
    offset = quat.skew(torch.tensor([0.0, S / M, 0.0]))
    mass = torch.cat((
        torch.cat((M * torch.eye(3), -M * offset), -1),
        torch.cat((M * offset, torch.diag(torch.tensor([I, 0.01, I]))), -1),
    ), -2)  # fmt: skip
    section = tb.Section(torch.diag(torch.tensor([1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9])), mass)
    springs = [
        tb.Load(
            lambda x, R, v, w, t: (
                -KH / 2 * x * x.new_tensor([0.0, 0, 1]),
                -KT / 2 * R[..., 2, 1:2] * x.new_tensor([1.0, 0, 0]),
            ),
            node=node, of=("position", "rotation"),
        )
        for node in (0, -1)
    ]  # fmt: skip
    zero = torch.zeros_like(speed)
    load = air(wind=torch.stack((zero, -speed, zero), -1), **lags)
    held = [tb.Support(0, "xy", "yz"), tb.Support(-1, "y", "yz")]
    return tb.Scene(tb.Beam.straight(1.0, 1, section), [load, *springs], supports=held)


def state_space(speed):
    """(6, 6) of (h, theta, h', theta', z_1, z_2): the same section with two lags."""
    apparent, b = math.pi * RHO * B**2, B
    lift_rate = torch.tensor([[-1.0, -b * A], [-b * A, -(b**2) * (1 / 8 + A**2)]])
    mass = torch.tensor([[M, S], [S, I]]) - apparent * lift_rate
    q = torch.tensor([0.0, speed, -1.0, b * (0.5 - A)])  # by (h, theta, h', theta')
    circulation = 2 * math.pi * RHO * speed * b * torch.tensor([1.0, b * (A + 0.5)])
    force = torch.zeros(2, 6)
    force[:, :4] = (1 - SHARES.sum()) * circulation[:, None] * q
    force[:, 4:] = circulation[:, None] * SHARES
    force[:, 3] += apparent * speed * torch.tensor([1.0, -b * (0.5 - A)])
    force[:, :2] -= torch.diag(torch.tensor([KH, KT]))
    out = torch.zeros(6, 6)
    out[:2, 2:4] = torch.eye(2)
    out[2:4] = torch.linalg.solve(mass, force)
    rates = RATES * speed / b
    out[4:, :4], out[4:, 4:] = rates[:, None] * q, -torch.diag(rates)
    return out


def test_typical_section():
    """Two degrees of freedom and two lags: eigenvalues at two speeds, and the speed of flutter,
    against those of a 6 x 6 matrix. 1e-6: the wing is 1e9 times as stiff as its springs; of the
    speed 2e-5, as motions count as growing from 1e-6 of their frequency on.
    """
    speeds = torch.tensor([8.0, 12.0])
    found = tb.modes(typical(speeds), count=2).eigenvalue
    for k, speed in enumerate(speeds.tolist()):
        wanted = torch.linalg.eigvals(state_space(speed))
        wanted = wanted[wanted.imag > 0]
        wanted = wanted[wanted.imag.argsort()]
        assert_close(found[k], wanted, rtol=1e-6, atol=0)

    def growth(speed):
        return torch.linalg.eigvals(state_space(speed)).real.amax().item()

    critical = tb.critical_load(typical, 60.0, lowest=5.0, points=8, count=2)
    assert critical.flutter
    low, high = 5.0, 60.0
    for _ in range(45):
        middle = (low + high) / 2
        low, high = (low, middle) if growth(middle) > 0 else (middle, high)
    assert_close(critical.factor, torch.tensor(low), rtol=2e-5, atol=0)


def test_the_same_equations_as_a_users_load():
    """Goland's wing at two speeds, 6 elements, by `tb.Load`: eigenvalues alike to rounding."""
    speeds = torch.tensor([100.0, 144.0])
    other = wing.goland(speeds, 6)
    wind = torch.stack((0 * speeds, -speeds, 0 * speeds), -1)
    load = tb.StripAir(wing.CHORD, axis=wing.AXIS, density=wing.DENSITY, wind=wind)
    found, wanted = (
        tb.modes(scene, count=3).eigenvalue for scene in (tb.Scene(other.beam, [load]), other)
    )
    assert_close(found, wanted, rtol=1e-11, atol=1e-9)


def test_work_of_the_air():
    """Energy of a wing in the wind changes by the work of the air, at each instant, to rounding."""
    wind = torch.tensor([1.0, -U, 2.0])
    scene = tb.Scene(tb.Beam.straight(3.0, 4, SECTION), [air(wind=wind)])
    run = tb.simulate(scene, torch.linspace(0, 0.1, 6), step=0.01, conserve=True)
    energy = run.energy.kinetic + run.energy.strain - run.energy.work
    assert run.energy.work[-1] > 1e-3
    assert_close(energy, energy[:1].expand(6), rtol=0, atol=1e-9 * run.energy.work[-1].item())


def test_which_way_the_chord_points():
    """A beam with its y axis astern and a negative chord is one with y ahead, and positive."""
    ahead = tb.Beam.straight(3.0, 3, SECTION)
    astern = tb.Beam.straight(3.0, 3, SECTION, up=(0, 0, -1))
    wind = torch.tensor([0.0, -U, 1.5])
    turned = wind * torch.tensor([1.0, -1, -1])  # about x, by half a turn
    one = tb.equilibrium(tb.Scene(ahead, [air(wind=wind)])).tip.position
    other = tb.equilibrium(tb.Scene(ahead, [air(-CHORD, wind=wind * torch.tensor([1, -1, 1]))]))
    assert_close(other.tip.position, one * torch.tensor([1.0, -1, 1]), rtol=1e-9, atol=1e-12)
    again = tb.equilibrium(tb.Scene(astern, [air(wind=turned)])).tip.position
    assert_close(again, one * torch.tensor([1.0, -1, -1]), rtol=1e-9, atol=1e-12)


def test_a_frame_that_flies():
    """In still air a wing whose frame moves ahead is one in the wind, to the solver's tolerance. A
    blade that is pitched and turns about z in a stream along z bears lift across the air that it
    meets, pi rho c V^2 sin(angle) per length, to 1e-6.
    """
    beam = tb.Beam.straight(3.0, 3, SECTION)
    flying = tb.Scene(beam, [air(wind=None)], frame=tb.Frame(velocity=(0, U, -1.5)))
    blown = tb.Scene(beam, [air(wind=(0.0, -U, 1.5))])
    assert_close(
        tb.equilibrium(flying).tip.position, tb.equilibrium(blown).tip.position,
        rtol=1e-9, atol=1e-9,
    )  # fmt: skip
    pitch, spin, stream = 0.3, 5.0, 2.0
    across = (0, -math.sin(pitch), math.cos(pitch))
    blade = tb.Beam.straight(3.0, 3, STIFF, up=across, root=(0.5, 0, 0))
    held = [tb.Support(k) for k in range(4)]
    rotor = tb.Scene(
        blade, [air(wind=(0, 0, stream), lags=None)], supports=held,
        frame=tb.Frame(angular_velocity=(0, 0, spin)),
    )  # fmt: skip
    load = -tb.equilibrium(rotor).reaction[:, 1:3]  # inertia is along the blade
    r, c, s = 0.5 + torch.arange(4.0), math.cos(pitch), math.sin(pitch)
    forward, upwash = spin * r * c - stream * s, spin * r * s + stream * c
    q = upwash + 0 * r
    share = math.pi * RHO * CHORD * torch.tensor([0.5, 1, 1, 0.5])
    suction, normal = share * q**2, share * forward * q
    wanted = torch.stack((suction * c - normal * s, suction * s + normal * c), -1)
    assert_close(load, wanted, rtol=1e-6, atol=0)


@refusals(
    (dict(chord=0.0), "StripAir's chord of 0 was given"),
    (dict(lags="theodorsen"), "lags = 'theodorsen' was given"),
    (dict(lags=[(0.7, 1.0), (0.6, 1.0)]), "shares of 1 in all"),
    (dict(wind=(0, 1.0)), r"of shape \(2,\) was given"),
    (dict(polar=3.0), "polar"),
)
def test_refusals(given):
    tb.StripAir(**dict(chord=1.0) | given)


def test_numbers_of_each_node():
    """A tapered chord as a function of s, of the nodes, and of the elements: the first two alike;
    a number of other length is refused.
    """
    beam = tb.Beam.straight(3.0, 4, SECTION)
    nodes = torch.linspace(1.0, 0.4, 5)
    wind = torch.tensor([0.0, -U, 1.0])

    def tip(chord):
        return tb.equilibrium(tb.Scene(beam, [air(chord, wind=wind)])).tip.position

    one = tip(nodes)
    assert_close(tip(lambda s: 1 - 0.2 * s), one, rtol=1e-12, atol=0)
    assert (tip((nodes[1:] + nodes[:-1]) / 2) - one).abs().amax() < 0.1 * one[2].abs()
    with pytest.raises(ValueError, match="chord of shape"):
        tip(torch.ones(3))


def test_wings_of_a_structure():
    """Air on one of two wings: the other stays; states are of its nodes alone, and turned on for
    both they are twice as many."""
    parts = dict(
        left=tb.Beam.straight(2.0, 2, SECTION, direction=(-1.0, 0, 0)),
        right=tb.Beam.straight(2.0, 2, SECTION),
    )
    held = [tb.Support(("left", 0)), tb.Support(("right", 0))]
    wind = torch.tensor([0.0, -U, 1.0])

    def bent(*effects):
        return tb.equilibrium(tb.Scene(parts, effects, supports=held))

    one = bent(air(wind=wind, on="right"))
    # outward along -x with z up, the left wing's y axis points astern
    both = bent(air(wind=wind, on="right"), air(-CHORD, wind=wind, on="left"))
    assert one.internal.shape[-1] == 6 and both.internal.shape[-1] == 12
    left, right = both["left"].tip.position, both["right"].tip.position
    assert_close(one["right"].tip.position, right, rtol=1e-9, atol=1e-12)
    assert one["left"].tip.position[2].abs() < 1e-12 < right[2]
    assert_close(left, right * torch.tensor([-1.0, 1, 1]), rtol=1e-9, atol=1e-12)


def test_wind_of_place_and_time():
    """A shear wind as a function of place and t; in a frame that turns it is asked in inertial axes
    and turned, as a constant one is.
    """
    beam = tb.Beam.straight(3.0, 3, SECTION)
    turning = tb.Frame(angular_velocity=(0, 0, 2.0))
    steady = torch.tensor([0.5, -3.0, 1.0])

    def run(wind):
        scene = tb.Scene(beam, [air(wind=wind)], frame=turning)
        return tb.simulate(scene, [0.0, 0.05, 0.1], step=0.01).tip.position

    one = run(steady)
    assert_close(run(lambda x, t: steady + 0 * x), one, rtol=1e-9, atol=1e-12)
    assert_close(run(lambda t: steady + 0 * t), one, rtol=1e-12, atol=1e-14)
    sheared = run(lambda x, t: steady * (1 + 0.1 * x[..., :1] + t))
    assert (sheared - one)[-1].abs().amax() > 1e-4


def test_polar_of_a_flat_plate():
    """Coefficients of the potential flow about a plate are the lift slope. A drag of 0.02 pushes
    astern by rho b V^2 0.02 per length, to 2 %; a moment of -0.05 per length turns the tip's nose
    down by M L^2/2 GJ, to 20 %: lift follows.
    """
    beam, wind = tb.Beam.straight(3.0, 3, SECTION), torch.tensor([0.0, -U, 0.5])

    def held(drag=0.0, moment=0.0, **more):
        def polar(angle):
            return 2 * math.pi * angle.sin(), drag + 0 * angle, moment + 0 * angle

        return tb.equilibrium(tb.Scene(beam, [air(wind=wind, **(more or dict(polar=polar)))]))

    plain = held()
    assert_close(plain.tip.position, held(polar=None).tip.position, rtol=1e-9, atol=1e-12)
    pressure = 3.0 * RHO * B * wind.square().sum()  # over the length
    astern = (held(drag=0.02).root.force - plain.root.force)[1]
    assert_close(astern, 0.02 * pressure, rtol=2e-2, atol=0)
    turned = (held(moment=-0.05).tip.rotation - plain.tip.rotation)[2, 1]
    assert_close(turned, -0.05 * CHORD * pressure * 1.5 / 5e3, rtol=0.2, atol=0)


def test_the_speed_of_flutter_differentiates():
    """Goland's wing, 2 elements: by its chord, against central differences."""
    beam = wing.goland(torch.tensor(100.0), 2).beam

    def speed(chord):
        load = tb.StripAir(chord, axis=wing.AXIS, wind=tb.Input("wind", 3))
        return tb.critical_load(
            tb.Scene(beam, [load]), 165.0, lowest=110.0, points=3, count=3, tolerance=1e-8,
            inputs={"wind": (0, -1.0, 0)},
        ).factor  # fmt: skip

    chord = torch.tensor([wing.CHORD], requires_grad=True)
    (slope,) = torch.autograd.grad(speed(chord), chord)
    with torch.no_grad():
        ends = [speed(chord + h) for h in (1e-3, -1e-3)]
    assert_close(slope, ((ends[0] - ends[1]) / 2e-3)[None], rtol=2e-4, atol=0)
