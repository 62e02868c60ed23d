"""Instants far from 0: runs and steps from there are those from 0, as far as the digits of the
instants tell, or refused by a sentence.
"""

import pytest
import torch

import torchbeam as tb

STEP = 0.02  # s
BEAM = tb.Beam.straight(
    1.0, 2, tb.Section.from_stiffness(EA=60.0, GA=40.0, GJ=0.8, EI=1.0, mass=0.2, inertia=0.05)
)


def ramp(begin, dtype):
    """A push that grows from `begin` on."""
    return tb.Scene(BEAM, [tb.TipLoad(force=lambda t: (0, 0, 90 * (t - begin)))], dtype=dtype)


def start(scene, begin):
    return tb.rest(scene, t=torch.tensor(begin, dtype=torch.float64).to(scene.dtype))


# the state two steps later
WAYS = {
    "steps of a length": lambda scene, b: tb.simulate(
        scene, [b, b + 2 * STEP], step=STEP, engine="eager"
    ).state[-1],
    "instants": lambda scene, b: tb.simulate(
        scene, [b, b + STEP, b + 2 * STEP], engine="eager", step=STEP
    ).state[-1],
    "adaptive steps": lambda scene, b: tb.simulate(
        scene, [b, b + 2 * STEP], rtol=1e-2, engine="eager"
    ).state[-1],
    "events": lambda scene, b: tb.simulate(
        scene,
        [b, b + 2 * STEP],
        rtol=1e-2,
        events=lambda state: state.tip.position[..., 2] - 1.0,
        engine="eager",
    ).state[-1],
    "an explicit method": lambda scene, b: tb.simulate(
        scene, [b, b + 2 * STEP], method="rk4", options={"step_size": STEP / 2}
    ).state[-1],
    "a mixed form": lambda scene, b: tb.simulate(
        scene, [b, b + 2 * STEP], form="minimal", method="rk4", options={"step_size": STEP / 2}
    ).state[-1],
    "a stepper": lambda scene, b: stepped(tb.Stepper(scene, STEP, engine="eager"), scene, b),
    "a rollout": lambda scene, b: tb.rollout(
        tb.Stepper(scene, STEP, engine="eager"), start(scene, b), 2
    )[-1],
    "an explicit stepper": lambda scene, b: stepped(
        tb.ExplicitStepper(scene, STEP, "rk4", form="nodal", options={"step_size": STEP / 2}),
        scene,
        b,
    ),
}


def stepped(stepper, scene, begin):
    return stepper(stepper(start(scene, begin)))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("way", WAYS)
def test_far_from_zero(way, dtype):
    """The tip's rise goes with the cube of the time: by so much it may be off. (In float32 126
    steps asked for at 1e5 s were 78.)
    """
    run = WAYS[way]
    wanted = run(ramp(0.0, dtype), 0.0).tip.position[..., 2].item()
    assert wanted > 1e-3
    for begin in (1e4, 1e12, 1e15):
        apart = torch.finfo(dtype).eps * begin
        try:
            found = run(ramp(begin, dtype), begin)
        except ValueError as error:
            assert "s apart; instants nearer to 0" in str(error) or "increasing" in str(error)
            assert apart > STEP / 50
            continue
        assert not found.status.any() and apart < STEP / 5
        off = 1e-3 + 10 * apart / STEP
        assert found.tip.position[..., 2].item() == pytest.approx(wanted, rel=off), begin


def test_steps_are_counted_in_double():
    """20 of 10 ms from 100 s on, in either precision, whatever the instants come in; of the same
    length but for the digits of the instants.
    """
    for dtype in (torch.float32, torch.float64):
        for given in (torch.float32, torch.float64):
            t = 100 + torch.linspace(0, 0.2, 11, dtype=torch.float64)
            scene = tb.Scene(BEAM, dtype=dtype)
            solution = tb.simulate(scene, t.to(given), step=0.01, engine="eager")
            assert solution.stats.steps == 20 and solution.t.dtype == dtype


# what a user may do with a state between two steps
BETWEEN = {
    "as it is": lambda state: state,
    "detached": lambda state: state.detach(),
    "a sample of a batch": lambda state: state.map(lambda x: x[None])[0],
}


@pytest.mark.parametrize("between", BETWEEN)
@pytest.mark.parametrize("kind", ["a stepper", "an explicit stepper", "repeat"])
def test_a_loop_keeps_the_time_of_a_run(kind, between):
    """In float32, whose numbers lie 0.5 ms apart at 8000 s, 10 steps of 10 ms go to 8000.1 s, as a
    run does. (Each used to begin at the rounded end of the one before: 8000.0977.)
    """
    scene = tb.Scene(BEAM, dtype=torch.float32)
    step = (
        tb.ExplicitStepper(scene, 0.01, "rk4", form="nodal", options={"step_size": 0.01})
        if kind == "an explicit stepper"
        else tb.Stepper(scene, 0.01, engine="eager")
    )
    advance = (lambda s: step.repeat(s, 2, {})) if kind == "repeat" else step
    state = start(scene, 8000.0)
    for _ in range(5 if kind == "repeat" else 10):
        state = BETWEEN[between](advance(state))
    run = tb.simulate(scene, [8000.0, 8000.1], step=0.01, engine="eager").state[-1]
    assert state.t == run.t == torch.tensor(8000.1, dtype=torch.float32)


def test_branches_and_states_that_were_set_back():
    """Each state goes on from its own instant: of 10 steps, after each of which another branch is
    tried; of one whose time was written to, or set, from there.
    """
    scene = tb.Scene(BEAM, dtype=torch.float32)
    stepper, state = tb.Stepper(scene, 0.01, engine="eager"), start(scene, 8000.0)
    for _ in range(10):
        stepper(stepper(state), dt=0.02)
        state = stepper(state)
    assert state.t == torch.tensor(8000.1, dtype=torch.float32)
    assert stepper(start(scene, 8000.0)).t == torch.tensor(8000.01, dtype=torch.float32)
    assert stepper(state.at(0.0)).t == torch.tensor(0.01, dtype=torch.float32)
    state.t.fill_(1.0)
    assert stepper(state).t == torch.tensor(1.01, dtype=torch.float32)


def test_digits_of_every_step():
    """A length given later, and a loop that comes to where float32 carries its steps no more, are
    refused like a first step.
    """
    scene = tb.Scene(BEAM, dtype=torch.float32)
    stepper = tb.Stepper(scene, 0.01, engine="eager")
    state = stepper(start(scene, 8000.0))
    with pytest.raises(ValueError, match="s apart; instants nearer to 0"):
        stepper(state, dt=1e-3)
    long = tb.Stepper(scene, 0.3, engine="eager")
    state = start(scene, torch.finfo(torch.float32).eps ** -1 * 0.03 - 0.5)
    state = long(state)
    with pytest.raises(ValueError, match="s apart; instants nearer to 0"):
        for _ in range(3):
            state = long(state)


def test_instants_in_single_precision_of_a_scene_in_double():
    """They are told apart by the intervals between them, not by the steps within."""
    t = torch.tensor([8000.0, 8000.25], dtype=torch.float32)
    scene = tb.Scene(BEAM, dtype=torch.float64)
    run = tb.simulate(scene, t, step=5e-3, engine="eager")
    assert run.stats.steps == 50 and run.t[-1] == 8000.25


@pytest.mark.steps
def test_a_loop_in_native_code_is_the_run():
    """200 steps from 8000 s on in float32, of a push that grows: the same time, and to rounding the
    same tip. (They came to 8001.953 s.)
    """
    push = tb.TipLoad(force=lambda t: (0, 0, 0.1 * (t - 8000)))
    scene = tb.Scene(BEAM, [push], dtype=torch.float32)
    stepper, state = tb.Stepper(scene, 0.01, engine="compiled"), start(scene, 8000.0)
    rolled = tb.rollout(stepper, state, 200)[-1]
    run = tb.simulate(scene, [8000.0, 8002.0], step=0.01, engine="compiled").state[-1]
    for _ in range(200):
        state = stepper(state)
    for one in (state, rolled, run):
        assert one.t == 8002.0
        assert one.tip.position[2].item() == pytest.approx(run.tip.position[2].item(), rel=1e-5)
