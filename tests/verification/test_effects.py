"""Effects on a whole beam against closed forms: decay, terminal velocity, frequencies with payloads
and springs, actuated shapes, lags; the mixed and the nodal form with each effect on.
"""

import math
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.nodal_cases import orders
from torchbeam.extend import quaternions as quat

STIFF = tb.Section.from_stiffness(EA=1e6, GA=1e6, GJ=0.8, EI=1.0, mass=0.5, inertia=0.01)
LIGHT = tb.Section.from_stiffness(EA=1e6, GA=1e6, GJ=0.8, EI=1.0, mass=1e-4, inertia=1e-9)
SOFT = tb.Section.from_stiffness(EA=60.0, GA=40.0, GJ=0.8, EI=1.0, mass=1.0, inertia=0.05)


def cantilever(N, section=STIFF, **options):
    return tb.Beam.straight(1.0, N, section, **options)


def run(scene, dt, steps, state=None, **options):
    stepper = tb.Stepper(scene, dt, **options)
    state = stepper.rest() if state is None else state
    for _ in range(steps):
        state = stepper(state)
    assert (state.status == 0).all()
    return state


def test_falling_through_a_fluid():
    """A free beam falls flat: v = V tanh(g t/V), V^2 = 2 m g/(rho d C_n). Midpoint steps of 1/40 of
    V/g: (1/40)^2/12 = 5e-5.
    """
    g, rho, d, C = 9.81, 1000.0, 0.01, 1.2
    V = math.sqrt(2 * 0.5 * g / (rho * d * C))
    scene = tb.Scene(
        cantilever(4), [tb.Gravity((0, 0, -g)), tb.Drag(rho, d, normal=C)], supports=()
    )
    state = None
    for steps in (40, 80):
        state = run(scene, V / g / 40, 40, state)
        want = torch.tensor([0, 0, -V * math.tanh(steps / 40)]).expand(5, 3)
        assert_close(state.velocity, want, rtol=0, atol=5e-5 * V)


def test_along_a_stream():
    """A free beam along x in a stream along x: m v' = 1/2 rho d pi C_t (U - v)^2, so
    1/(U - v) = 1/U + k t.
    """
    U, rho, d, C = 2.0, 1000.0, 0.02, 0.01
    k = rho * d * math.pi * C / 2 / 0.5
    scene = tb.Scene(
        cantilever(3), [tb.Drag(rho, d, normal=1.2, tangential=C, flow=(U, 0, 0))], supports=()
    )
    state = run(scene, 0.01, 50)
    want = torch.tensor([U - 1 / (1 / U + k * 0.5), 0, 0]).expand(4, 3)
    assert_close(state.velocity, want, rtol=0, atol=1e-4 * U)


@pytest.mark.parametrize("method", ["midpoint", "generalized_alpha", "rk4"])
@pytest.mark.parametrize("options", [{}, {"plane": "xz"}, {"small": True}])
def test_added_mass_of_a_rigid_motion(method, options):
    """A free beam at 30 degrees to its weight, in a fluid without drag: across a = m g/(m + m_a),
    along a = g, m_a = C_a rho pi d^2/4. It does not turn, so that every method is exact; the
    weight's work is the beam's energy and the fluid's, m_a v^2/2.
    """
    c, s = math.cos(math.pi / 6), math.sin(math.pi / 6)
    added, g, T = 0.8 * 40.0 * math.pi * 0.1**2 / 4, 9.81, 0.2
    beam = cantilever(3, SOFT, direction=(c, 0.0, s), up=(-s, 0.0, c))
    scene = tb.Scene(
        beam,
        [tb.Gravity((0, 0, -g)), tb.Drag(40.0, 0.1, normal=0.0, added_mass=0.8)],
        supports=(),
        **options,
    )
    how = dict(options={"step_size": 0.02}) if method == "rk4" else dict(step=0.02, tolerance=1e-12)
    solution = tb.simulate(scene, [0.0, T], method=method, **how)
    along, across = -g * s, -g * c / (1 + added)
    moved = (solution.nodes[-1] - beam.nodes) / (T**2 / 2)
    assert_close(
        moved,
        torch.tensor([along * c - across * s, 0.0, along * s + across * c]).expand(4, 3),
        rtol=0,
        atol=1e-9,
    )
    kinetic = ((along * T) ** 2 + (across * T) ** 2) / 2
    assert_close(solution.energy.kinetic[-1].item(), kinetic, rtol=1e-9, atol=0)
    assert_close(solution.energy.work[-1].item(), kinetic, rtol=1e-9, atol=0)


def test_wet_frequencies():
    """Bending in water: dry frequencies times sqrt(m/(m + m_a)), with lumped masses and no rotary
    inertia exactly; stretching stays, at 2 c/h sin(h k/2) of a chain of masses, k = pi/2L.
    """
    of = tb.Section.from_stiffness(EA=1e3, GA=1e3, GJ=0.8, EI=(1.0, 1.5), mass=0.4)
    water = tb.Drag(1000.0, 0.03, added_mass=1.0)
    ratio = (0.4 / (0.4 + 1000.0 * math.pi * 0.03**2 / 4)) ** 0.5
    dry, wet = (tb.Scene(cantilever(6, of), effects) for effects in ([], [water]))
    still = tb.rest(dry)
    a, b = (tb.modes(scene, still, count=18, lumped=True).frequency for scene in (dry, wet))
    bending, axial = a[:4] * ratio, 2 * (1e3 / 0.4) ** 0.5 * 6 * math.sin(math.pi / 24)
    assert ((b[:, None] - bending).abs().amin(0) < 1e-7 * bending).all()
    assert (a - axial).abs().min() < 1e-6 * axial and (b - axial).abs().min() < 1e-6 * axial


def test_turning_in_a_fluid():
    """A stiff rod spins about a hinge: I w' = -rho d C_n/2 (sum x^3 dx) w^2, so 1/w = 1/w0 + K t,
    with I and the sum of the mesh: trapezoidal, I less the coupled mass' part. w from the angular
    momentum, which bending does not shake; midpoint steps of a 2 % loss of w each: 1e-4.
    """
    N, rho, d, C, w0 = 8, 100.0, 0.02, 1.2, 2.0
    section = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=1e3, EI=1e3, mass=0.5, inertia=1e-8)
    scene = tb.Scene(
        cantilever(N, section), [tb.Drag(rho, d, normal=C)], supports=[tb.Support(0, rotation="xy")]
    )
    x, h = torch.linspace(0, 1, N + 1), 1 / N
    share = torch.full((N + 1,), h)
    share[0] = share[-1] = h / 2
    lumped = (0.5 * share * x**2).sum()
    K = rho * d * C / 2 * (share * x**3).sum() / (lumped - N * 0.5 * h / 12 * h**2)
    start = tb.rest(scene)
    turning = torch.tensor([0, 0, w0]).expand(N + 1, 3)
    start = replace(start, velocity=torch.linalg.cross(turning, start.position), spin=turning)
    state = run(scene, 0.005, 80, start)
    momentum = (0.5 * share[:, None] * torch.linalg.cross(state.position, state.velocity)).sum(0)[2]
    assert_close(momentum / lumped, 1 / (1 / w0 + K * 0.4), rtol=1e-4, atol=0)


def test_mass_damping_decay():
    """A mode released with a velocity: exp(-alpha t/2) sin(w t), w^2 = w0^2 - alpha^2/4 with w0 of
    the undamped beam's mode 1; after 1.25 periods. 200 steps: phase lag (w dt)^2/12 of 1.25
    periods = 1e-3, which changes a sine at its top by 1e-6, and amplitude 1e-4; lumped, where the
    damping is alpha times the mass.
    """
    alpha, small = 2.0, 1e-5
    scene = tb.Scene(cantilever(6), [tb.MassDamping(alpha)])
    mode = tb.modes(tb.Scene(scene.beam), count=4, lumped=True)
    shape = mode.shape[0].real
    w0 = mode.frequency[0].item()
    w = math.sqrt(w0**2 - alpha**2 / 4)
    start = tb.rest(scene)
    start = replace(start, velocity=small * shape[:, :3], spin=small * shape[:, 3:])
    t = 1.25 * 2 * math.pi / w
    state = run(scene, t / 200, 200, start, lumped=True)
    tip = state.position[-1] - scene.beam.nodes[-1]
    along = (tip * shape[-1, :3]).sum() / shape[-1, :3].square().sum()
    want = small / w * math.exp(-alpha * t / 2)
    assert along.item() == pytest.approx(want, rel=1e-3)


@pytest.mark.parametrize("offset", [None, (0.2, 0.0, 0.0), (0.0, 0.0, 0.1)])
@pytest.mark.parametrize("mass", [0.01, 100.0])
def test_payload(mass, offset):
    """A body on a beam of 1/100 to 1e-6 of its mass: det(K - w^2 M) = 0 with the tip's flexibility
    L^3/3EI, L^2/2EI, L/EI in the x-z plane (u_z, theta_y) and the body's mass, offset and inertia.
    Mesh error 1/(4 N^2) = 4e-4 in K; beam's mass 33/140 of 1e-4/0.01.
    """
    J = 0.05 * mass
    scene = tb.Scene(cantilever(24, LIGHT), [tb.PointMass(mass, inertia=(J, J, J), offset=offset)])
    c = torch.zeros(3) if offset is None else torch.tensor(offset)
    # a force along z turns the tip about -y
    K = torch.linalg.inv(torch.tensor([[1 / 3, -1 / 2], [-1 / 2, 1.0]]))
    # velocity of the centre: z' - theta' c_x along z, theta' c_z along x (which the beam's stretch
    # would have to follow)
    M = mass * torch.tensor([[1.0, -c[0]], [-c[0], c[0] ** 2 + c[2] ** 2]]) + torch.tensor(
        [[0, 0], [0, J]]
    )
    want = torch.linalg.eigvals(torch.linalg.solve(M, K)).real.sqrt().sort().values
    found = tb.modes(scene, count=8)
    out_of_plane = found.shape[:, -1, 2].abs() > found.shape[:, -1, 1].abs()
    first = found.frequency[out_of_plane][0]
    assert first.item() == pytest.approx(want[0].item(), rel=3e-3)


def test_payload_moves_as_its_mode():
    """The implicit step with 100 times the beam's mass on the tip: released at the deflection of
    its weight, it is through rest after a quarter period of sqrt(3 EI/(M L^3)); 50 steps a quarter:
    phase 1e-4; Rayleigh's 33/140 of the beam's 1 %: 1.2e-3.
    """
    M, g = 50.0, 1e-4
    scene = tb.Scene(cantilever(8, STIFF), [tb.PointMass(M), tb.Gravity((0, 0, -g))])
    still = tb.equilibrium(scene)
    assert (still.tip.position[2]).item() == pytest.approx(-M * g / 3 - 0.5 * g / 8, rel=5e-3)
    quarter = math.pi / 2 / math.sqrt(3 / (M + 0.5 * 33 / 140))
    free = tb.Scene(scene.beam, [tb.PointMass(M)])
    state = run(free, quarter / 50, 50, still)
    assert abs(state.tip.position[2].item() / still.tip.position[2].item()) < 0.01


def test_spring_supported_tip():
    """Body on a light cantilever, tied by a spring along its motion: w^2 = (3 EI/L^3 + k)/M; mesh
    error 1/(4 N^2).
    """
    M, k = 0.5, 4.0
    scene = tb.Scene(cantilever(16, LIGHT), [tb.PointMass(M), tb.Spring(-1, k, to=(1.0, 0, 0))])
    found = tb.modes(scene, count=2).frequency
    assert_close(found, torch.full((2,), math.sqrt((3 + k) / M)), rtol=1e-3, atol=0)


def test_rigid_rod_on_a_root_spring():
    """A stiff rod on torsion springs k: w^2 = k/(m L^3/3), once about y, once about z with another
    k; 1e6 times stiffer along.
    """
    section = tb.Section.from_stiffness(EA=1e6, GA=1e6, GJ=1e5, EI=1e5, mass=0.5, inertia=1e-8)
    k = torch.tensor([1e6, 1e6, 1e6, 1e3, 0.3, 0.7])
    scene = tb.Scene(cantilever(8, section), [tb.RootSpring(k)])
    found = tb.modes(scene, count=2).frequency
    assert_close(found, (torch.tensor([0.3, 0.7]) / (0.5 / 3)).sqrt(), rtol=2e-3, atol=0)


def test_root_spring_under_a_load():
    """Statics: the clamp gives F/k and M/k, the rest is the clamped beam's; small load."""
    P, k = 1e-4, torch.tensor([5.0, 6.0, 7.0, 8.0, 9.0, 10.0])
    springs, clamp = (
        tb.equilibrium(tb.Scene(cantilever(8), [tb.TipLoad(force=(0, P, 0)), *more]))
        for more in ((tb.RootSpring(k),), ())
    )
    root = springs.node(0)
    assert_close(root.position, torch.tensor([0, P / 6.0, 0]), rtol=0, atol=1e-3 * P)
    turn = quat.logarithm(springs.rotation[0])
    assert_close(turn, torch.tensor([0, 0, P / 10.0]), rtol=0, atol=1e-3 * P)
    gained = springs.tip.position - clamp.tip.position
    assert_close(gained, torch.tensor([0, P / 6 + P / 10, 0]), rtol=0, atol=1e-3 * P)


@pytest.mark.parametrize("k", [(0.0, 0.0, 3.0), (0.0, -2.0, 0.0), (1.0, 2.0, -1.0)])
def test_actuated_beam_is_a_helix(k):
    """An intrinsic curvature alone: no stress, and the tip turned by exp(k L), exactly; in a plane
    a circle of that curvature, whose chords are h long instead of 2 sin(k h/2)/k:
    (k h)^2/24 = 6e-4.
    """
    k = torch.tensor(k)
    state = tb.equilibrium(tb.Scene(cantilever(24), [tb.Actuation(curvature=k)]))
    assert state.stress.abs().max() < 1e-9
    assert_close(
        quat.matrix(state.rotation[-1]), quat.matrix(quat.exponential(k)), rtol=0, atol=1e-10
    )
    if k[0] == 0:
        size = torch.linalg.vector_norm(k)
        axis = k / size
        across = torch.linalg.cross(axis, torch.tensor([1.0, 0, 0]))
        want = (
            torch.tensor([1.0, 0, 0]) * torch.sin(size) / size
            + across * (1 - torch.cos(size)) / size
        )
        assert_close(state.tip.position, want, rtol=0, atol=1e-3)


def test_actuated_stretch_and_input():
    """An intrinsic stretch lengthens; an Input of curvature is its value; half of the elements give
    half of the turn.
    """
    beam = cantilever(4)
    state = tb.equilibrium(tb.Scene(beam, [tb.Actuation(strain=(0.1, 0, 0))]))
    assert_close(state.tip.position, torch.tensor([1.1, 0, 0]), rtol=0, atol=1e-12)
    scene = tb.Scene(beam, [tb.Actuation(curvature=tb.Input("k", 3), elements=range(2))])
    state = tb.equilibrium(scene, inputs={"k": torch.tensor([0, 0, 0.6])})
    assert_close(quat.logarithm(state.rotation[-1]), torch.tensor([0, 0, 0.3]), rtol=0, atol=1e-10)


def test_lagged_actuator():
    """z' = (u - z)/T from zero: u (1 - exp(-t/T)); steps of T/20: (1/20)^2/12 = 2e-4."""
    T, u = 0.1, torch.tensor([0.0, 0.2, 0.1])
    load = tb.Load(
        lambda x, R, v, w, t, z: (z, None), node=-1, internal=3,
        rate=lambda z, x, R, v, w, t: (u - z) / T, of=(),
    )  # fmt: skip
    state = run(tb.Scene(cantilever(3), [load]), T / 20, 30)
    assert_close(state.internal.flatten(), u * (1 - math.exp(-1.5)), rtol=2e-4, atol=0)


def stream(x, t):
    """A flow that varies in space and time."""
    return torch.stack((x[..., 1], x[..., 0], x[..., 0] + t), -1)


def thrust(on):
    """Of s and t."""
    return tb.Along(lambda s, t: on[..., None] * torch.stack((s, s * t, -s * s), -1))


def drag(x, R, v, w, t, on):
    """Of the velocity, which turns with the spin."""
    return -on[..., None] * torch.linalg.cross(w, v), -0.1 * on[..., None] * w


EACH = {  # on (..., 1): 1 where the sample has the effect, else 0
    "Drag": lambda on: tb.Drag(20.0 * on[..., 0], 0.2, tangential=0.1),
    "Drag in a flow": lambda on: tb.Drag(20.0 * on[..., 0], 0.2, flow=stream),
    "MassDamping": lambda on: tb.MassDamping(2.0 * on[..., 0]),
    "Spring": lambda on: tb.Spring(-1, 5.0 * on[..., 0], to=(0.8, 0, 0), length=0.1),
    "LineLoad of s": lambda on: tb.LineLoad(force=thrust(on), follower=True),
    "Load": lambda on: tb.Load(drag, node=None, values={"on": on}),
    "PointMass": lambda on: tb.PointMass(
        2.0 * on[..., 0], inertia=on * torch.tensor([0.1, 0.2, 0.3]), offset=(0.05, 0.1, 0.0)
    ),
}
PUSH = tb.TipLoad(force=(0.5, 1.0, 2.0))


def one_each(names):
    """The push, and one effect a sample: the last has none. (What is zero is absent:
    unit/scene/test_effects.py.)
    """
    return [
        PUSH,
        *(
            EACH[name](on[:, None])
            for name, on in zip(names, torch.eye(len(names) + 1), strict=False)
        ),
    ]


def test_both_forms_tend_to_one_motion():
    """Nodal and minimal form of one scene at t = 0.3, N = 2 and 4: the tips' distance falls as h^2,
    and what each effect does is larger than it.
    """
    names = [name for name in EACH if name != "PointMass"]
    t, apart = torch.tensor([0.0, 0.3]), []
    for N in (2, 4):
        scene = tb.Scene(cantilever(N, SOFT), one_each(names))
        minimal = tb.simulate(scene, t, form="minimal", rtol=1e-3, atol=1e-4).tip.position[-1]
        nodal = tb.simulate(scene, t, step=0.01).tip.position[-1]
        apart.append((nodal - minimal).norm(dim=-1))
    does = (nodal - nodal[-1]).norm(dim=-1)
    for k, name in enumerate(names):
        assert does[k] > apart[-1][k], name
        assert (orders([one[k] for one in apart]) > 1.5).all(), (name, apart)


def drift(energy):
    """Largest |kinetic + strain - work| over the largest strain energy, of each sample."""
    return (energy.kinetic + energy.strain - energy.work).abs().amax(0) / energy.strain.amax(0)


def test_energy_balance():
    """Kinetic and strain energy grow by the work of the loads (springs are loads): undamped, 3D,
    large motion. The mean-strain step's own drift at this size, without the effect, is the measure:
    three times it, and 1e-4 of the peak.
    """
    t, beam = torch.linspace(0, 0.3, 7), cantilever(4, SOFT)
    drifts = drift(tb.simulate(tb.Scene(beam, one_each([*EACH])), t, step=0.005).energy)
    clamp = tb.RootSpring((50.0, 5.0), damping=(1.0, 0.1))
    found = dict(zip(EACH, drifts, strict=False)) | {
        "RootSpring": drift(tb.simulate(tb.Scene(beam, [PUSH, clamp]), t, step=0.005).energy)
    }
    assert {name: x for name, x in found.items() if x >= max(3 * drifts[-1], 1e-4)} == {}
