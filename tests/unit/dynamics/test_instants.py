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
    """100 of 10 ms from 100 s on, in either precision, whatever the instants come in; of the same
    length but for the digits of the instants.
    """
    for dtype in (torch.float32, torch.float64):
        for given in (torch.float32, torch.float64):
            t = 100 + torch.linspace(0, 1, 11, dtype=torch.float64)
            scene = tb.Scene(BEAM, dtype=dtype)
            solution = tb.simulate(scene, t.to(given), step=0.01, engine="eager")
            assert solution.stats.steps == 100 and solution.t.dtype == dtype
