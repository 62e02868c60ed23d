"""An input with a value of its own for each element: as the numbers are, in every solver."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

N = 4
SECTION = tb.Section.from_stiffness(EA=60.0, GA=40.0, GJ=1.2, EI=(1.0, 1.7), mass=1.0, inertia=0.02)
BEAM = tb.Beam.straight(1.0, N, SECTION)
VALUES = torch.randn(2, 3 * N, generator=torch.Generator().manual_seed(3))
OF = {
    "line": lambda value: tb.LineLoad(force=tb.PerElement(value)),
    "follower": lambda value: tb.LineLoad(
        force=tb.PerElement(value), moment=(0.0, 0.1, 0.0), follower=True
    ),
    "actuation": lambda value: tb.Actuation(curvature=tb.PerElement(value), elements=(0, 2, 3)),
}
GIVEN = tb.Input("own", 3 * N)


IN_PLANE = {"line": (1.0, 0, 1), "follower": (1.0, 0, 1), "actuation": (0.0, 1, 0)}  # of "xz"


def both(of, plane=None):
    """The scene by an input, and the one by its value."""

    def scene(value):
        return tb.Scene(BEAM, [OF[of](value), tb.Damping(0.02)], plane=plane)

    return scene(GIVEN), lambda value: scene(value.unflatten(-1, (N, 3)))


@pytest.mark.parametrize(
    ("of", "engine"),
    [
        *((of, "eager") for of in OF),
        pytest.param("line", "compiled", marks=pytest.mark.long),  # as the follower
        ("follower", "compiled"),
        ("actuation", "compiled"),
    ],
)
def test_an_input_of_each_element_is_its_numbers(of, engine):
    """Steps with two samples' values, and their gradient by the values: to rounding, 1e-12 and
    1e-9. In space eagerly, natively in a plane.
    """
    plane = "xz" if engine == "compiled" else None
    by_input, by_value = both(of, plane)
    values = VALUES * (torch.tensor(IN_PLANE[of]).repeat(N) if plane else 1.0)

    def answer(scene, value, **inputs):
        value = value.clone().requires_grad_()
        made = scene(value) if callable(scene) else scene
        given = {"own": value} if scene is by_input else {}
        t, options = torch.linspace(0, 0.06, 3), dict(step=0.02, engine=engine, tolerance=1e-12)
        x = tb.simulate(made, t, inputs=given, **options).tip.position[-1]
        return x, torch.autograd.grad((x * torch.tensor([1.0, -2.0, 0.5])).sum(), value)[0]

    for got, wanted, size in zip(
        answer(by_input, values), answer(by_value, values), (1e-12, 1e-9), strict=True
    ):
        assert_close(got, wanted, rtol=size, atol=size)


def test_equilibria_rollouts_and_linear_models_take_it():
    """Statics; values that change from step to step; the input matrix of a linear model, column by
    column from statics: its static gain is the derivative of the equilibrium.
    """
    by_input, by_value = both("line")
    small = 1e-3 * VALUES
    assert_close(
        tb.equilibrium(by_input, inputs={"own": small}).position,
        tb.equilibrium(by_value(small)).position,
        rtol=0,
        atol=1e-12,
    )
    stepper, every = tb.Stepper(by_input, 0.02), torch.stack((VALUES, 2 * VALUES, -VALUES), -2)
    state = tb.rest(by_input, (2,))
    for k in range(3):
        state = stepper(state, own=every[:, k])
    assert_close(
        tb.rollout(stepper, tb.rest(by_input, (2,)), 3, own=tb.PerInterval(every))[-1].position,
        state.position,
        rtol=0,
        atol=1e-13,
    )
    model = tb.linearize(
        by_input, outputs=[tb.sensors.TipPosition()], inputs={"own": torch.zeros(3 * N)}
    )
    gain = model.D - model.C @ torch.linalg.solve(model.A, model.B)
    wanted = torch.func.jacrev(
        lambda u: tb.equilibrium(by_input, inputs={"own": u}, tolerance=1e-12).tip.position
    )(torch.zeros(3 * N))
    assert_close(gain, wanted, rtol=0, atol=1e-8 * float(wanted.abs().max()))


def test_its_size_is_checked():
    with pytest.raises(ValueError, match="size 12 is wanted, three of each of 4 elements"):
        tb.Scene(BEAM, [tb.LineLoad(force=tb.PerElement(tb.Input("own", 3)))])
    assert "PerElement(input 'own')" in str(tb.describe(both("line")[0]))
