"""Derivative of one step in the coordinates of a linear model, and the states of such
coordinates.
"""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

U = torch.tensor([0.1, 0.5, 0.4])


def drag(r, R, v, w, t, z):
    return -0.3 * z, None


def lag(z, r, R, v, w, t):
    return 10.0 * (v - z)


def scene(*effects, EI=(1.0, 1.3), inertia=1e-3, order=1, N=3, **of):
    section = tb.Section.from_stiffness(EA=4e3, GA=1.4e3, GJ=0.8, EI=EI, mass=0.2, inertia=inertia)
    return tb.Scene(
        tb.Beam.straight(1.0, N, section, order=order),
        [tb.TipLoad(force=tb.Input("u", 3)), *effects],
        **of,
    )


HUB = dict(supports=tb.Support(0, "xyz", ""))  # free to turn, with a body on it
BODY = (tb.PointMass(0.1, inertia=(0.02, 0.02, 0.02), node=0), tb.Gravity((0, 0, -9.81)))
SCENES = {
    "clamped, in 3D": scene(tb.Damping(1e-3), tb.Gravity((0, 0, -9.81))),
    "in a plane": scene(*BODY[:1], plane="xy", supports=tb.Support(0, "xyz", "xy")),
    "small": scene(small=True),
    "order 2": scene(tb.Damping(1e-3), order=2, N=2),
    "two supports": scene(supports=(tb.Support(0, "xyz", "xyz"), tb.Support(-1, "yz", ""))),
    "rotating": scene(frame=tb.Frame(angular_velocity=(0.0, 0.0, 3.0))),
    "without rotary inertia": scene(inertia=0.0),
    "without rotary inertia, damped": scene(tb.Damping(0.01), inertia=0.0),
    "internal states": scene(tb.Load(drag, node=-1, internal=3, rate=lag, of=("velocity",))),
    "relaxing": scene(tb.Viscoelastic((0.3, 0.2), (0.01, 0.5)), N=2),
    "a batch of beams": scene(EI=torch.tensor([1.0, 2.0])),
}


def model_of(scene):
    return tb.linearize(scene, inputs={"u": torch.zeros(3)})


def coordinates(model, seed=1):
    """z of a bent and moving beam: moves of up to 5 cm or 3 degrees, rates up to 5 cm/s."""
    return 0.05 * (
        2 * torch.rand(model.A.shape[-1], generator=torch.Generator().manual_seed(seed)) - 1
    )


def differences(function, like, h=1e-5):
    """Central differences of a function of a small change (..., k), all k at once: (..., k) behind
    its value's axes.
    """
    e = h * torch.eye(like.shape[-1]).view(-1, *(1,) * (like.ndim - 2), like.shape[-1])
    return ((function(e) - function(-e)) / (2 * h)).movedim(0, -1)


def is_the_slope(held, model, engine):
    """The Jacobian of a step of a scene, against central differences 1e-5 apart, of steps solved to
    1e-13: what those leave is 1e-8 of the largest entry.
    """
    stepper = tb.Stepper(held, 0.02, tolerance=1e-13, engine=engine)
    z = coordinates(model)
    A, B = stepper.jacobian(model.state_at(z), U, model)

    count = z.shape[-1]

    def after(e):
        state = model.state_at(z + e[..., :count])
        return model.departure(stepper(state, u=U + e[..., count:]))

    wanted = differences(after, torch.cat((A, B), -1)).split((count, len(U)), -1)
    for found, slope in zip((A, B), wanted, strict=True):
        assert_close(found, slope, rtol=0, atol=1e-8 * max(1.0, slope.abs().max().item()))


@pytest.mark.parametrize("kind", SCENES)
def test_state_at_is_the_inverse_of_departure(kind):
    """To Newton's quadratic convergence, rounding; what supports hold is where they have it."""
    model = model_of(SCENES[kind])
    z = coordinates(model)
    state = model.state_at(z)
    assert_close(model.departure(state), z.expand_as(model.departure(state)), rtol=0, atol=1e-12)
    assert_close(state.position[..., 0, :], model.state.position[..., 0, :], rtol=0, atol=1e-14)
    if kind == "two supports":
        assert_close(state.position[-1, 1:], model.state.position[-1, 1:], rtol=0, atol=1e-14)


@pytest.mark.parametrize("engine", ["eager", "auto"])
@pytest.mark.parametrize("kind", SCENES)
def test_is_the_slope_of_a_step(kind, engine):
    is_the_slope(SCENES[kind], model_of(SCENES[kind]), engine)


def test_of_an_arm_that_has_turned_far():
    """A hub free about all axes, turned by 1 rad and turning by 2 rad/s: the same slope; engines
    agree to 1e-9.
    """
    # the model is of the beam without gravity
    held, free = scene(*BODY, **HUB, N=2), scene(*BODY[:1], **HUB, N=2)
    model = tb.linearize(free, tb.rest(free), inputs={"u": torch.zeros(3)})
    z = coordinates(model)
    half = len(z) // 2
    z[:3] += torch.tensor([0.5, -0.4, 0.8])
    z[half : half + 3] += torch.tensor([1.0, 1.0, -1.5])
    found = []
    for engine in ("eager", "auto"):
        stepper = tb.Stepper(held, 0.01, tolerance=1e-13, engine=engine)
        A, B = stepper.jacobian(model.state_at(z), {"u": U}, model)
        found.append(torch.cat((A, B), -1))
    wanted = differences(lambda e: model.departure(stepper(model.state_at(z + e), u=U)), A)
    assert_close(found[0], found[1], rtol=0, atol=1e-9)
    assert_close(A, wanted, rtol=0, atol=1e-7 * wanted.abs().max().item())


def test_at_the_equilibrium_it_is_the_model_in_steps():
    """The midpoint step of z' = A z + B u is (1 - A dt/2)^-1 (1 + A dt/2) z + ...; a step of the
    beam has that slope where the model is from, to rounding of stiffness over mass: 1e-9 of the
    largest entry.
    """
    held, dt = scene(tb.Damping(1e-3)), 0.01
    model = model_of(held)
    A, B = tb.Stepper(held, dt, tolerance=1e-13).jacobian(model.state, torch.zeros(3), model)
    eye = torch.eye(len(A))
    wanted = torch.linalg.solve(
        eye - model.A * dt / 2, torch.cat((eye + model.A * dt / 2, model.B * dt), -1)
    )
    assert_close(torch.cat((A, B), -1), wanted, rtol=0, atol=1e-8 * wanted.abs().max().item())


def test_a_batch_is_its_samples_and_leaves_the_stepper_as_it_was():
    held = SCENES["in a plane"]
    model, stepper = model_of(held), tb.Stepper(held, 0.02)
    z, u = torch.stack([coordinates(model, k) for k in range(3)]), torch.stack((U, -U, 0 * U))
    states = model.state_at(z)
    with torch.no_grad():
        A, B = stepper.jacobian(states, u, model)
    assert stepper.iterations is None and not A.requires_grad
    for k in range(3):
        alone = stepper.jacobian(states[k], u[k], model)
        assert_close((A[k], B[k]), alone, rtol=0, atol=1e-12 * A.abs().max().item())


def test_of_a_reduced_model():
    """Its own coordinates: the amplitudes of two modes; at the equilibrium the step keeps them
    apart from the others.
    """
    held, dt = scene(), 0.01
    full = model_of(held)
    model = full.reduced(2)
    assert_close(
        model.departure(model.state_at(0.02 * torch.ones(4))),
        0.02 * torch.ones(4),
        rtol=0,
        atol=1e-12,
    )
    A, _ = tb.Stepper(held, dt, tolerance=1e-13).jacobian(model.state, torch.zeros(3), model)
    eye = torch.eye(4)
    assert_close(
        A, torch.linalg.solve(eye - model.A * dt / 2, eye + model.A * dt / 2), rtol=0, atol=1e-7
    )


def test_refusals():
    held = SCENES["in a plane"]
    model = model_of(held)
    with pytest.raises(ValueError, match="method='generalized_alpha' was given to jacobian"):
        tb.Stepper(held, 0.01, "generalized_alpha", rho_inf=0.9).jacobian(model.state, U, model)
    with pytest.raises(ValueError, match=r"u of shape \(2,\) was given; \(..., 3\) is wanted"):
        tb.Stepper(held, 0.01).jacobian(model.state, torch.zeros(2), model)
    with pytest.raises(ValueError, match="z of shape"):
        model.state_at(torch.zeros(2))
    with pytest.raises(ValueError, match="coordinates that no configuration has"):
        model.state_at(1e6 * torch.ones(model.A.shape[-1]))
