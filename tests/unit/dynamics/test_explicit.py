"""ExplicitStepper: torchdiffeq one interval at a time, in every form."""

import math

import pytest
import torch

import torchbeam as tb

FORMS = ("nodal", "minimal", "block_rate")


def scene() -> tb.Scene:
    """A silicone rod soft enough for explicit steps: 0.3 m, radius 10 mm, E = 1 MPa, density 1100
    kg/m^3, two elements.
    """
    return tb.Scene(
        tb.Beam.straight(0.3, 2, tb.Section.circle(0.01, 1e6, 0.45, 1100.0)),
        [tb.TipLoad(force=tb.Input("u", 3))],
    )


def stepper(form: str, interval: float = 0.005) -> tb.ExplicitStepper:
    return tb.ExplicitStepper(scene(), interval, "rk4", form, options={"step_size": 5e-4})


def test_mixed_forms_agree():
    """minimal and block rate are one semi-discrete system: four intervals of an input that jumps
    between them agree to the integration's own error (rk4 at 0.5 ms: 1.6e-8 of the 1.15 mm
    travelled).
    """
    tips = []
    for form in ("minimal", "block_rate"):
        step = stepper(form)
        state = step.rest()
        for k in range(4):
            state = step(state, u=[0.0, 0.05, 0.02 * (-1) ** k])
        tips.append(state.tip.position)
    torch.testing.assert_close(tips[0], tips[1], rtol=0, atol=2e-8 * 0.00115)


@pytest.mark.parametrize("form", FORMS)
def test_gradient_through_intervals(form):
    """Derivative of the tip by a held force over three intervals, against central differences
    (h = 1e-4 of 0.05 N; the tip is linear in so small a force, so 1e-6 is rounding).
    """
    step = stepper(form)
    force = torch.tensor([0.05, 0.05 + 5e-6, 0.05 - 5e-6], requires_grad=True)
    state = step.rest((3,))
    for _ in range(3):
        state = step(state, u=torch.stack((0 * force, force, 0 * force), -1))
    tip = state.tip.position[:, 1]
    (slope,) = torch.autograd.grad(tip[0], force)
    assert slope[0].item() == pytest.approx(((tip[1] - tip[2]) / 1e-5).item(), rel=1e-6)


@pytest.mark.parametrize("form", FORMS)
def test_a_failing_sample_is_alone(form):
    """A NaN input: that sample keeps its state and gets a status; the others move as if it were not
    there.
    """
    step = stepper(form)
    state = step.rest((3,))
    u = torch.tensor([[0, 0.05, 0], [0, math.nan, 0], [0, 0, 0.05]])
    after, fine = step(state, u=u), step(state, u=torch.nan_to_num(u))
    assert after.status[1] != 0 and after.status[[0, 2]].tolist() == [0, 0]
    assert torch.isfinite(after.nodes).all() and torch.equal(after.nodes[1], state.nodes[1])
    torch.testing.assert_close(after.nodes[[0, 2]], fine.nodes[[0, 2]], rtol=0, atol=1e-12)
    alone = step(step.rest(), u=[0, math.nan, 0])
    assert alone.status != 0 and torch.isfinite(alone.nodes).all()


def test_what_it_refuses():
    for arguments, sentence in (
        ({"form": "modal"}, "form = 'modal'"),
        ({"method": "rk5"}, "method = 'rk5'"),
    ):
        with pytest.raises(ValueError, match=sentence):
            tb.ExplicitStepper(scene(), 0.02, **arguments)


def test_an_error_of_a_load_is_no_failed_motion():
    scene = tb.Scene(
        tb.Beam.straight(0.3, 2, tb.Section.circle(0.01, 1e6, 0.45, 1100.0)),
        [tb.Load(lambda r, R, v, w, t: (torch.zeros(2, 3) @ torch.zeros(4), None), node=-1)],
    )
    stepper = tb.ExplicitStepper(scene, 0.005, form="nodal")
    with pytest.raises(RuntimeError, match="size mismatch"):
        stepper(stepper.rest())


def test_work_adds_up():
    """The nodal form's work over two intervals is that of one run over them: the same steps, to
    rounding. Inactive members, given as a plain list, keep theirs.
    """
    step, u = stepper("nodal", 0.02), torch.tensor([[0.0, 0.05, 0.0], [0.0, 0.0, 0.03]])
    state = step.rest((2,))
    for _ in range(2):
        state = step(state, u=u)
    run = tb.simulate(
        scene(), 0.02 * torch.arange(3), step.rest((2,)), "rk4", options={"step_size": 5e-4},
        inputs={"u": u},
    )  # fmt: skip
    assert (run.energy.work[-1] > 0).all()
    torch.testing.assert_close(state.work, run.energy.work[-1], rtol=1e-9, atol=0)
    after = step(state, active=[True, False], u=u)
    assert after.work[1] == state.work[1] and after.t[1] == state.t[1] and after.t[0] > state.t[0]


@pytest.mark.parametrize("form, push", [("nodal", 0.05), ("minimal", 0.05), ("nodal", 0.0)])
def test_a_failure_has_its_instant(form, push):
    """A load that turns NaN after 7.5 ms: the state is good at 5 ms and before, failed and held
    from 10 ms on, also where it was at rest until then. (The block rate form reads the load's rate,
    which is zero on both sides.)
    """

    def force(t):
        up = torch.where(t < 0.0075, push, math.nan)
        return torch.stack(
            (torch.stack((0 * t, up, 0 * t)), torch.stack((0 * t, 0 * t, 0 * t + 0.05)))
        )

    beam = tb.Beam.straight(0.3, 2, tb.Section.circle(0.01, 1e6, 0.45, 1100.0))
    scene = tb.Scene(beam, [tb.TipLoad(force=force)])
    with pytest.warns(RuntimeWarning):
        sol = tb.simulate(
            scene, torch.arange(5) * 0.005, form=form, method="rk4", options={"step_size": 5e-4}
        )
    assert (sol.state.status != 0).tolist() == [[False, False]] * 2 + [[True, False]] * 3
    assert "t = 0.005 s" in sol.stats.reason[3] and torch.equal(sol.nodes[2, 0], sol.nodes[1, 0])


def test_who_rests_is_not_judged_by_a_support_that_has_moved_on():
    """A sample that stood still while the others moved keeps its own time: the others go on, where
    its support would have led it is not asked; and when it goes on too it is where they were then,
    to rounding.
    """
    still = scene()
    moving = tb.Support(
        0, displacement=lambda t: torch.stack((0 * t, 0.02 * torch.sin(8 * t), 0 * t))
    )
    step = tb.ExplicitStepper(
        tb.Scene(still.beam, still.loads, supports=moving), 0.001, "rk4", "nodal",
        options={"step_size": 5e-4},
    )  # fmt: skip
    state, u = step.rest((2,)), torch.zeros(2, 3)
    for _ in range(2):
        state = step(state, active=[True, False], u=u)
    assert state.status.tolist() == [0, 0] and state.t.tolist() == pytest.approx([0.002, 0.0])
    for _ in range(2):
        state = step(state, active=[False, True], u=u)
    torch.testing.assert_close(state.nodes[1], state.nodes[0], rtol=0, atol=1e-14)
    assert state.nodes[0, -1, 1].abs() > 0
