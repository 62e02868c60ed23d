"""Inertia of joints against Lagrange's equations, closed forms and chains of joints."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from torch.testing import assert_close

import torchbeam as tb

G = 9.81
T = torch.linspace(0, 1, 5, dtype=torch.float64)
RODS = (1.0, 0.09), (0.7, 0.06)  # mass and inertia about the centre of links of 1 m
FALL = tb.Gravity((0, 0, -G))


def link(k: int, x: float) -> tb.Body:
    mass, inertia = RODS[k]
    return tb.Body(mass, (0.05, inertia, 0.09), position=(x, 0, 0))


def two_links(A=(0.3, 0.2)) -> tb.Scene:
    """Two links that fall from level, with rotors at the shoulder and at the elbow."""
    shoulder = tb.Hinge(None, "arm", axis=(0, 1, 0), at=(0, 0, 0), inertia=A[0])
    elbow = tb.Hinge("arm", "fore", axis=(0, 1, 0), at=(1.0, 0, 0), inertia=A[1])
    return tb.Scene({"arm": link(0, 0.5), "fore": link(1, 1.5)}, [FALL], joints=[shoulder, elbow])


def of_two_links(q, u) -> list[float]:
    """Accelerations by Lagrange's equations, of angles about y."""
    (m, I), (n, J) = RODS
    c, h = n / 2 * np.cos(q[1]), n / 2 * np.sin(q[1])
    M = [[I + m / 4 + J + n * 5 / 4 + 2 * c + 0.3, J + n / 4 + c], [J + n / 4 + c, J + n / 4 + 0.2]]
    pull = n / 2 * G * np.cos(q.sum())
    push = (m / 2 + n) * G * np.cos(q[0]) + pull + h * (2 * u[0] + u[1]) * u[1]
    return np.linalg.solve(M, [push, pull - h * u[0] ** 2]).tolist()


SPRING, A = 60.0, 0.5


def slides() -> tb.Scene:
    """A link that falls, on which a body slides against a spring and an inertia."""
    shoulder = tb.Hinge(None, "arm", axis=(0, 1, 0), at=(0, 0, 0))
    rail = tb.Slider("arm", "fore", axis=(1, 0, 0), inertia=A, stiffness=SPRING)
    return tb.Scene({"arm": link(0, 0.5), "fore": link(1, 0.5)}, [FALL], joints=[shoulder, rail])


def of_slides(q, u) -> list[float]:
    (m, I), (n, J) = RODS
    r = 0.5 + q[1]
    turn = G * (m / 2 + n * r) * np.cos(q[0]) - 2 * n * r * u[0] * u[1]
    slide = n * r * u[0] ** 2 + n * G * np.sin(q[0]) - SPRING * q[1]
    return [turn / (I + m / 4 + J + n * r**2), slide / (n + A)]


@pytest.mark.parametrize(
    ("scene", "accelerations"), [(two_links, of_two_links), (slides, of_slides)]
)
def test_is_that_of_lagranges_equations(scene, accelerations):
    """Midpoint steps are of second order, `midpoint4` of fourth: to 3e-7 rad and m of a motion of
    1 rad with steps of 12.5 ms, beside SciPy's to 1e-12.
    """

    def rates(t, y):
        q, u = np.split(y, 2)
        return [*u, *accelerations(q, u)]

    exact = solve_ivp(rates, (0, 1), np.zeros(4), rtol=1e-12, atol=1e-12, t_eval=T.numpy())

    def error(method: str, step: float) -> float:
        joints = tb.simulate(scene(), T, method=method, step=step, engine="compiled").joint
        q = np.array([joint.coordinate.numpy() for joint in joints])
        return np.abs(q - exact.y[:2]).max()

    assert np.abs(exact.y[:2]).max() > 0.8
    for method, order in (("midpoint", 2), ("midpoint4", 4)):
        assert abs(np.log2(error(method, 0.025) / error(method, 0.0125)) - order) < 0.1
    assert error("midpoint4", 0.0125) < 3e-7


def test_hinges_keep_the_energy_over_ten_thousand_steps():
    """Of a chaotic motion of 15 J, to rounding."""
    t = torch.linspace(0, 200, 101, dtype=torch.float64)
    energy = tb.simulate(two_links(), t, step=0.02, engine="compiled").energy
    assert energy.kinetic.max() > 10
    total = energy.kinetic + energy.strain - energy.work
    assert_close(total, torch.zeros_like(total), rtol=0, atol=1e-8)


def test_a_slider_on_a_link_that_turns_keeps_the_energy_to_second_order():
    """Its error does not grow over 200 s: 3e-3 of 7 J with steps of 20 ms."""
    t = torch.linspace(0, 200, 101, dtype=torch.float64)
    energy = tb.simulate(slides(), t, step=0.02, engine="compiled").energy
    off = (energy.kinetic + energy.strain - energy.work).abs()
    assert off.max() < 5e-3 and off[50:].max() < 2 * off[:50].max()


@pytest.mark.parametrize("engine", ["eager", "compiled"])
def test_an_inertia_to_the_ground_is_the_bodys_own(engine):
    """The same states as of the body with so much more inertia about the axis, and the same
    forces, to rounding.
    """
    axis = torch.tensor((0.6, 0.8, 0.0))
    J, at = torch.diag(torch.tensor((0.15, 0.16, 0.12))), torch.tensor((0.4, 0.1, 0.2))

    def run(body: float, hinge: float) -> tb.Solution:
        part = tb.Body(0.7, J + body * torch.outer(axis, axis), position=at)
        joint = tb.Hinge(None, "a", axis=axis, at=(0, 0, 0), stiffness=2.0, inertia=hinge)
        scene = tb.Scene({"a": part}, [FALL], joints=[joint])
        return tb.simulate(scene, T[:3] / 2, step=0.05, engine=engine)

    ours, theirs = run(0.0, 0.1), run(0.1, 0.0)
    assert theirs.joint[0].coordinate.abs().max() > 0.1
    for name in ("position", "spin", "joints"):
        x, y = getattr(ours.state, name), getattr(theirs.state, name)
        y = y if name != "joints" else torch.cat((y[..., :9], x[..., 9:]), -1)
        assert_close(x, y, rtol=1e-10, atol=1e-10)
    for name in ("kinetic", "work"):
        assert_close(getattr(ours.energy, name), getattr(theirs.energy, name), rtol=0, atol=1e-10)


def hung(kind: str) -> tb.Scene:
    """A body on another one that hangs from a spring, by a joint of two coordinates or by two of
    one each, with next to nothing between them.
    """
    foot = tb.Body(1.0, (0.05, 0.06, 0.04), position=(-0.3, 0, 0))
    hub = tb.Body(0.5, (0.02, 0.03, 0.025), position=(0.3, 0.1, -0.2))
    between = {"c": tb.Body(1e-7, 1e-7)} if kind in ("hinges", "slider and hinge") else {}
    slant, z, y, at = (0.6, 0, 0.8), (0, 0, 1), (0, 1, 0), (0, 0, 0)
    joints = {
        "universal": [tb.Universal("foot", "hub", axis=z, second=y, at=at, inertia=(0.1, 0.06))],
        "hinges": [
            tb.Hinge("foot", "c", axis=z, at=at, inertia=0.1),
            tb.Hinge("c", "hub", axis=y, at=at, inertia=0.06),
        ],
        "cylindrical": [
            tb.Cylindrical(
                "foot", "hub", axis=slant, at=at, inertia=(0.1, 0.7), stiffness=(0, 20.0)
            )
        ],
        "slider and hinge": [
            tb.Slider("foot", "c", axis=slant, at=at, inertia=0.7, stiffness=20.0),
            tb.Hinge("c", "hub", axis=slant, at=at, inertia=0.1),
        ],
    }[kind]
    ball = tb.Ball(None, "foot", at=(-0.5, 0.1, 0.1), stiffness=2.0)
    parts = {"foot": foot, **between, "hub": hub}
    return tb.Scene(parts, [tb.Gravity((0, 2.0, -G))], joints=[ball, *joints])


@pytest.mark.parametrize(
    ("joint", "chain"), [("universal", "hinges"), ("cylindrical", "slider and hinge")]
)
def test_two_coordinates_are_a_chain_of_two_joints(joint, chain):
    """In space, to 1e-6 m of a motion of 1 m: the body between has 2e-7 of the mass."""
    x, y = (
        tb.simulate(hung(k), T, method="midpoint4", step=0.01, engine="compiled")
        for k in (joint, chain)
    )
    assert (x["hub"].position - x["hub"].position[0]).abs().max() > 1
    assert_close(x["hub"].position, y["hub"].position, rtol=0, atol=1e-6)


def test_closing_the_energy_takes_it_in():
    """`conserve` of both engines: with the energy of what turns in joints, nothing is left over of
    a motion whose energy is kept anyway.
    """
    ends = {}
    for engine in ("eager", "compiled"):
        A = torch.tensor((0.3, 0.2), requires_grad=True)
        stepper = tb.Stepper(two_links(A.unbind()), 0.02, engine=engine, conserve=True)
        state = stepper.rest()
        for _ in range(2):
            state = stepper(state)
        assert state.defect.abs() < 1e-9
        x = torch.stack([part for joint in state.joint for part in (joint.coordinate, joint.rate)])
        ends[engine] = x, *torch.autograd.grad(x.sum(), A)
    for x, y in zip(*ends.values(), strict=True):
        assert_close(x, y, rtol=1e-9, atol=1e-10)


def test_geared_rotor_with_a_spring():
    """Between two discs and to the ground: frequency sqrt(k (1/(A + J J'/(J + J')))); with a
    damper the poles of (J + A) s^2 + c s + k.
    """
    k, A, c, J, other = 5.0, 0.3, 0.2, 0.09, 0.05
    disc, ring = tb.Body(1.0, (0.05, J, 0.09)), tb.Body(1.0, (0.05, other, 0.05))
    laws = dict(axis=(0, 1, 0), at=(0, 0, 0), inertia=A, stiffness=k)
    two = tb.Scene({"disc": disc, "ring": ring}, joints=[tb.Hinge("disc", "ring", **laws)])
    frequency = tb.modes(two, count=7).frequency[-1].item()
    assert abs(frequency / (k / (A + J * other / (J + other))) ** 0.5 - 1) < 1e-9
    one = tb.Scene({"disc": disc}, joints=[tb.Hinge(None, "disc", damping=c, **laws)])
    poles = torch.linalg.eigvals(tb.linearize(one).A).numpy()
    np.testing.assert_allclose(poles, np.roots([J + A, c, k]), rtol=1e-12)


def test_beam_on_a_hinge_with_inertia():
    """Euler and Bernoulli's: of a free end and a pin with EI w'' = -A omega^2 w' there. Four
    bending modes to 2e-4, by ten elements that are next to rigid in shear.
    """
    EI, mass, A = 1.0, 0.3, 0.05
    section = tb.Section.from_stiffness(EA=1e7, GA=1e7, GJ=1e4, EI=(EI, 1e4), mass=mass)
    beam = tb.Beam.straight(1.0, 10, section, order=2)
    hinge = tb.Hinge(None, ("beam", 0), axis=(0, 1, 0), at=(0, 0, 0), inertia=A)
    scene = tb.Scene({"beam": beam}, joints=[hinge], plane="xz")
    own = tb.modes(scene, count=5).frequency.numpy()

    def determinant(b: float) -> float:
        """w = C (cos - cosh) + D sin + E sinh of b x."""
        cos, sin, cosh, sinh = np.cos(b), np.sin(b), np.cosh(b), np.sinh(b)
        turn = A * EI * b**4 / mass * b
        return np.linalg.det(
            [[-2 * EI * b**2, turn, turn], [-cos - cosh, -sin, sinh], [sin - sinh, -cos, cosh]]
        ) / (cosh * b**2)

    places = np.linspace(0.3, 12, 2000)
    signs = np.sign([determinant(b) for b in places])
    roots = [brentq(determinant, *places[[k, k + 1]]) for k in np.flatnonzero(np.diff(signs))]
    assert own[0] < 1e-3
    np.testing.assert_allclose(own[1:], np.square(roots) * (EI / mass) ** 0.5, rtol=1e-3)


def test_in_a_frame_that_turns():
    """Between parts the motion is that in an inertial frame, to 1e-9 m."""
    foot = tb.Body(1.0, (0.1, 0.2, 0.25), position=(0.2, 0, 0))
    hub = tb.Body(0.5, (0.05, 0.1, 0.08), position=(1.0, 0, 0))
    elbow = tb.Hinge("foot", "hub", axis=(0, 0.6, 0.8), at=(0.8, 0, 0), inertia=0.2, torque=0.5)
    ball = tb.Ball(None, "foot", at=(0, 0, 0))
    still = tb.Scene({"foot": foot, "hub": hub}, joints=[elbow, ball])
    omega = torch.tensor((0.0, 0.0, 2.0))
    rest = tb.rest(still)
    spin = omega.expand(2, 3).clone()
    start = replace(rest, spin=spin, velocity=torch.linalg.cross(spin, rest.position))
    t = T / 2
    there = tb.simulate(still, t, start, method="midpoint4", step=0.01, engine="compiled")[
        "hub"
    ].position
    turning = replace(still, frame=tb.Frame(angular_velocity=omega))
    here = tb.simulate(turning, t, method="midpoint4", step=0.01, engine="compiled")["hub"].position
    c, s = torch.cos(2 * t), torch.sin(2 * t)
    x, y, z = here.unbind(-1)
    assert_close(torch.stack((c * x - s * y, s * x + c * y, z), -1), there, rtol=0, atol=1e-9)


def test_refused():
    hinge = tb.Hinge(None, "a", axis=(0, 1, 0), inertia=0.1)
    parts, frame = {"a": tb.Body(1.0, 0.1)}, tb.Frame(angular_velocity=(0, 0, 1.0))
    with pytest.raises(ValueError, match="inertia to the ground, which is frame a, beside a Frame"):
        tb.Scene(parts, joints=[hinge], frame=frame)
    scene = tb.Scene(parts, joints=[hinge])
    with pytest.raises(ValueError, match="a joint with inertia was given to generalized_alpha"):
        tb.Stepper(scene, 0.01, "generalized_alpha")
    with pytest.raises(ValueError, match="Hinge with angle and inertia was given"):
        tb.Hinge(None, "a", inertia=0.1, angle=0.2)
    with pytest.raises(ValueError, match="inertia"):
        tb.Hinge(None, "a", inertia=-0.1)
