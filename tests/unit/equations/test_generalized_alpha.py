"""The generalized-alpha step: its tangent against forward mode, order, what it damps, gradients,
reactions.
"""

import itertools
import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.nodal_cases import orders, scene, state
from tests.cases.refusals import refusals
from tests.cases.tangent_cases import assert_newton_inverts
from torchbeam.equations.generalized_alpha import AlphaState, GeneralizedAlphaProblem
from torchbeam.nodal.discretise import discretise

pytestmark = pytest.mark.steps

CASES = [
    dict(damping="one"), dict(damping="six"), dict(), dict(effects=()), dict(rotary=False),
    dict(coupled=False, damping="six"), dict(effects=[tb.Drag(1.2, 0.4, added_mass=0.8)]),
]  # fmt: skip


def problem_of(case, batch=(3,)):
    of = scene(batch=batch, **case)
    known = state(of)
    torch.manual_seed(3)
    nodes = known.position.shape[-2]
    start = AlphaState(
        **vars(known),
        acceleration=torch.randn(*batch, nodes, 12),
        straining=torch.randn(*batch, nodes - 1, 12),
    )
    return GeneralizedAlphaProblem(
        discretise(of), start, torch.tensor(0.1), torch.tensor(0.3), {}, rho_inf=0.7
    )


@pytest.mark.parametrize("case", CASES, ids=str)
def test_newton_update_inverts_the_derivative_of_the_residual(case):
    """As for the midpoint step, at a random iterate with every effect on."""
    problem = problem_of(case)
    x = problem.predictor()
    torch.manual_seed(7)
    push = torch.nn.functional.pad(0.2 * torch.randn(3, x.stress.shape[-2], 6), (0, 0, 1, 0))
    assert_newton_inverts(
        problem, problem.update(x, push, torch.randn_like(x.stress)), nodes=1e-9, strain=1e-10
    )


def smooth(tau=0.0, scale=1.0):
    """A soft chain of three under loads that rise from zero smoothly, in space."""
    of = tb.Section.from_stiffness(
        EA=200.0, GA=100.0, GJ=0.8, EI=(1.0, 2.0), mass=0.2, inertia=0.01
    )
    load = tb.TipLoad(
        force=lambda t: (
            scale * torch.stack((0 * t, 2 * torch.sin(3 * t) ** 2, torch.sin(2 * t) ** 2))
        ),
        moment=lambda t: torch.stack((0.3 * torch.sin(2 * t) ** 2, 0 * t, 0 * t)),
    )
    return tb.Scene(tb.Beam.straight(1.0, 3, of), [load, *([tb.Damping(tau)] if tau else [])])


def run(of, step, end=0.4, **options):
    return tb.simulate(
        of, torch.linspace(0, end, 3), method="generalized_alpha", step=step, tolerance=1e-12,
        **options,
    )  # fmt: skip


@pytest.mark.parametrize(
    "rho, tau, what, longest",
    [
        pytest.param(1.0, 0.0, "position", 0.01, marks=pytest.mark.long),
        (0.5, 0.0, "position", 0.02),
        (0.8, 0.05, "reaction", 0.02),
    ],
)
def test_second_order_in_time(rho, tau, what, longest):
    """Differences of neighbours at 20, 10, 5, 2.5 ms fall by four, from 10 ms on where nothing
    takes high modes out; damped, where no high mode swings, in the reaction too. The limit is the
    midpoint step's (extrapolated, both to 1e-5).
    """
    of, end = smooth(tau), 0.2 if tau else 0.08
    ends = [run(of, longest / 2**k, end, rho_inf=rho).state[-1] for k in range(4)]
    gaps = [(getattr(a, what) - getattr(b, what)).norm() for a, b in itertools.pairwise(ends)]
    assert_close(orders(gaps), torch.full((2,), 2.0), rtol=0, atol=0.1)
    other = [
        tb.simulate(of, torch.linspace(0, end, 3), step=step).state[-1] for step in (0.01, 0.005)
    ]
    limit, ours = (b.position + (b.position - a.position) / 3 for a, b in (other, ends[-2:]))
    assert (ours - limit).norm() < 2e-5


def bar(rho, modes=(1, 8)):
    """What 35 steps leave of the energy (means over 16 instants): a bar of eight elements that
    swings along itself in one of its modes, sin((mode - 1/2) pi x), so little that it is linear;
    omega_1 dt = 0.1, omega_8 dt = 1.2. A sample for each.
    """
    c = 10.0
    rod = tb.Section.from_stiffness(EA=c**2, GA=1.0, GJ=1.0, EI=1.0, mass=1.0)
    of = tb.Scene(tb.Beam.straight(1.0, 8, rod), plane="xz")
    at_rest = tb.rest(of, (len(modes),)).broadcast()
    along = 1e-4 * torch.sin(
        (torch.tensor(modes)[:, None, None] - 0.5) * math.pi * at_rest.position[..., :1]
    )
    start = tb.State(**{**vars(at_rest), "velocity": torch.nn.functional.pad(along, (0, 2))})
    dt = 0.1 / (math.pi / 2 * c)
    sol = tb.simulate(
        of, dt * torch.arange(51), start, method="generalized_alpha", step=1.001 * dt, rho_inf=rho
    )
    energy = sol.energy.kinetic + sol.energy.strain
    return (energy[-16:].mean(0) / energy[:16].mean(0)).tolist()


def test_damps_high_modes_alone():
    """The first mode keeps its energy whatever rho (0.9995 at 1/2); the eighth is left 0.97, 0.90
    and 0.23 at rho = 1, 0.8, 1/2 (1: the start's acceleration is a mean over a step, the energy
    swings about a constant).
    """
    first, eighth = zip(*(bar(rho) for rho in (1.0, 0.8, 0.5)), strict=True)
    assert min(first) > 0.999
    assert eighth[0] > 0.95
    assert eighth[1] < 0.92
    assert eighth[2] < 0.25


def test_gradient_against_differences():
    """d(tip)/d(load), reverse mode, through the accelerations of the start too: to the rounding of
    central differences.
    """

    def tip(scale):
        return run(smooth(0.05, scale), 0.02, rho_inf=0.6).tip.position[-1].sum()

    scale = torch.tensor(1.0, requires_grad=True)
    (slope,) = torch.autograd.grad(tip(scale), scale)
    wanted = (tip(torch.tensor(1 + 1e-5)) - tip(torch.tensor(1 - 1e-5))) / 2e-5
    assert_close(slope, wanted, rtol=1e-7, atol=0)


def test_reaction_of_a_sudden_load_is_smoother():
    """A force along a stiff bar, sudden, omega_1 dt = 7: the reaction settles, the midpoint step's
    swings on.
    """
    of = tb.Section.from_stiffness(EA=4e4, GA=1.48e4, GJ=0.769, EI=1.0, mass=0.2, inertia=5e-6)
    pulled = tb.Scene(tb.Beam.straight(1.0, 8, of), [tb.TipLoad(force=(1.0, 0, 0))])
    swings = {}
    for method, options in (("midpoint", {}), ("generalized_alpha", dict(rho_inf=0.5))):
        sol = tb.simulate(pulled, torch.linspace(0, 0.4, 41), method=method, step=0.01, **options)
        swings[method] = (sol.root.force[20:, 0] + 1).abs().max().item()
    assert swings["generalized_alpha"] < 1e-3
    assert swings["midpoint"] > 0.1


def test_restart_and_steps():
    """A Stepper from rest, and a restart from the middle: the same states, accelerations
    included.
    """
    of = smooth()
    stepper = tb.Stepper(of, 0.02, method="generalized_alpha", rho_inf=0.8, tolerance=1e-12)
    now = stepper.rest()
    for _ in range(20):
        now = stepper(now)
    whole = run(of, 0.02, rho_inf=0.8)
    assert_close(now.position, whole.state[-1].position, rtol=0, atol=1e-13)
    middle = whole.state[1]
    again = tb.simulate(
        of, torch.tensor([0.2, 0.4]), middle, method="generalized_alpha", step=0.02, rho_inf=0.8,
        tolerance=1e-12,
    )  # fmt: skip
    assert_close(again.state[-1].position, whole.state[-1].position, rtol=0, atol=1e-12)


def test_an_input_that_bends_the_beam():
    """Held, it is the number itself, in the trial step too."""
    bend, t = torch.tensor([0.0, 0.3, 0.0]), torch.linspace(0, 0.1, 3)
    section = tb.Section.from_stiffness(EA=1e3, GA=400.0, GJ=0.8, EI=1.0, mass=0.5, inertia=0.01)
    found = [
        tb.simulate(
            tb.Scene(tb.Beam.straight(1.0, 2, section), [tb.Actuation(curvature=by)], plane="xz"),
            t,
            step=0.05,
            method="generalized_alpha",
            inputs=inputs,
        ).nodes
        for by, inputs in ((bend, {}), (tb.Input("bend", 3), {"bend": bend}))
    ]
    assert_close(*found, rtol=0, atol=1e-14)


def test_another_method_goes_on_from_its_state():
    """ "midpoint" takes what it knows of the state and leaves the accelerations: bit for bit."""
    middle = run(smooth(), 0.02).state[1]
    assert type(middle) is not tb.State
    t = torch.tensor([0.2, 0.3])
    one, other = (tb.simulate(smooth(), t, start, step=0.02) for start in (middle, middle.plain()))
    assert type(one.state) is tb.State
    assert_close(one.state.position, other.state.position, rtol=0, atol=0)


@refusals(
    (dict(conserve=True), "conserve was given"),
    (dict(rho_inf=1.5), "from 0 to 1"),
    (dict(method="midpoint", rho_inf=0.5), "has none"),
)
def test_options(options):
    tb.Stepper(smooth(), 0.01, **{"method": "generalized_alpha", **options})


@pytest.mark.parametrize("engine", ["eager", "auto"])
def test_a_state_of_a_plane_goes_on_in_space(engine):
    """And one of space in a plane: what the method remembers is in other coordinates there, so that
    it starts anew, with the mean rates of a trial step. Within 1e-2 of the way of one run in the
    plane: what is left is the second start's.
    """
    beam = tb.Beam.straight(0.3, 3, tb.Section.circle(0.01, 1e6, 0.45, 1100.0))
    scenes = [
        tb.Scene(beam, [tb.TipLoad(force=[0.0, 0.0, 0.02])], plane=plane) for plane in ("xz", None)
    ]
    t, how = torch.linspace(0, 0.05, 14), dict(method="generalized_alpha", engine=engine, step=4e-3)
    whole = tb.simulate(scenes[0], torch.linspace(0, 0.1, 27), **how).tip.position[-1]
    for first, second in (scenes, scenes[::-1]):
        half = tb.simulate(first, t, **how).state[-1]
        end = tb.simulate(second, t + 0.05, half, **how).tip.position[-1]
        assert_close(end, whole, rtol=0, atol=1e-2 * whole[2].item())
