"""The implicit step as its users see it: energy, sub-steps, checkpoints, masks, files."""

import math
import warnings
from dataclasses import replace

import pytest
import torch

import torchbeam as tb
from torchbeam import extend


def soft_beam(**changes) -> tb.Beam:
    """The coupled section of the energy study: 3D, bending couples with extension."""
    K = torch.diag(torch.tensor([1e3, 400, 400, 0.8, 1, 2]))
    K[2, 3] = K[3, 2] = 0.3
    K[0, 5] = K[5, 0] = 5
    return tb.Beam.straight(
        1.0,
        4,
        tb.Section(torch.linalg.inv(K), torch.diag(torch.tensor([1, 1, 1, 0.02, 0.01, 0.01]))),
    )


def slender(N: int = 16) -> tb.Beam:
    """The section of the common dynamic case (reference/dynamic_step_load.json)."""
    return tb.Beam.straight(1.0, N, tb.Section.from_stiffness(4e4, 1.4835e4, 0.769, 1.0, 0.2, 5e-6))


def balance(sol: tb.Solution) -> torch.Tensor:
    return sol.energy.kinetic + sol.energy.strain - sol.energy.work


@pytest.mark.steps
@pytest.mark.parametrize(
    "conserve, steps, most",
    [
        pytest.param(False, 500, 5e-4, marks=pytest.mark.long),
        pytest.param(True, 500, 1e-12, marks=pytest.mark.long),
        (True, 100, 1e-12),
    ],
)
def test_energy_of_long_undamped_motion(conserve, steps, most):
    """Undamped 3D coupled cantilever, dead tip load, steps of 20 ms: the balance closes by
    construction with `conserve` (1e-12 is rounding over 500 steps) and to third order in the step
    without (measured 2.7e-4 of the peak; 100 steps of these are those of
    properties/test_dynamics::test_energy_of_the_coupled_case).
    """
    scene = tb.Scene(soft_beam(), [tb.TipLoad(force=(0, 1.0, 3.0))])
    sol = tb.simulate(
        scene, 0.02 * torch.arange(0, steps + 1, 20), step=0.02 * 1.0001, conserve=conserve
    )
    assert balance(sol).abs().max() < most * sol.energy.strain.max()


@pytest.mark.steps
@pytest.mark.parametrize("conserve, most", [(False, 1e-4), (True, 1e-12)])
def test_energy_of_a_beam_that_bends_by_itself(conserve, most):
    """A suddenly curled beam, undamped: what the curl would take to hold back (1/2 EI kappa^2 L at
    first) is what there is, and kinetic + strain energy stays there: exactly with `conserve`, else
    to the order of the step (4.4e-5 measured).
    """
    scene = tb.Scene(slender(8), [tb.Actuation(curvature=(0, 0, 0.5))])
    sol = tb.simulate(scene, torch.linspace(0, 0.5, 26), step=0.005, conserve=conserve)
    total = sol.energy.kinetic + sol.energy.strain
    torch.testing.assert_close(total[0], torch.tensor(0.5 * 0.5**2), rtol=1e-12, atol=0)
    assert (total - total[0]).abs().max() < most * total[
        0
    ] and sol.energy.kinetic.max() > 0.3 * total[0]
    if not conserve:
        explicit = tb.simulate(scene, [0, 3e-4], method="dopri5").energy
        torch.testing.assert_close(
            (explicit.kinetic + explicit.strain)[1], total[0], rtol=1e-5, atol=0
        )


@pytest.mark.steps
def test_conserve_takes_only_what_damping_does_not():
    """With damping, energy falls by exactly what the damper takes: `defect` stays at zero and the
    beam comes to rest at the static equilibrium (the damper does not shift it).
    """
    scene = tb.Scene(soft_beam(), [tb.TipLoad(force=(0, 0.5, 0.5)), tb.Damping(0.3)])
    sol = tb.simulate(scene, [0.0, 7.0], step=0.04, conserve=True)
    assert sol.state.defect.abs().max() < 1e-12
    still = tb.equilibrium(scene).tip.position
    # first bending mode: omega = 3.516 rad/s, tau omega^2/2 = 1.85 1/s, so e^-13 = 2e-6 of 0.18 m
    # is left
    assert (sol.tip.position[-1] - still).abs().max() < 5e-6


@pytest.mark.steps
def test_violent_load_is_made_in_smaller_steps():
    """P L^2/EI = 50 applied suddenly at 10 ms: whole steps have spurious solutions that gain energy
    50-fold; steps in which a node turns by more than 1.2 rad are refused and made in parts. The
    energy stays within 3 % (measured 1.4 %).
    """
    scene = tb.Scene(slender(), [tb.TipLoad(force=(0, 50.0, 0))])
    sol = tb.simulate(scene, torch.linspace(0, 0.3, 4), step=0.01)
    assert sol.status == 0
    assert sol.stats.iterations.max() > 12  # more than one Newton solve was needed somewhere
    assert balance(sol).abs().max() < 0.03 * sol.energy.strain.max()


def test_gradient_through_steps_that_were_made_again():
    """The derivative of the tip through sub-divided steps against central differences (fourth
    order, h = 1e-4 relative).
    """
    h = 6e-3
    P = (60 + h * torch.tensor([0.0, 1, 2, -2, -1])).requires_grad_()
    stepper = tb.Stepper(
        tb.Scene(slender(4), [tb.TipLoad(force=torch.stack((0 * P, P, 0 * P), -1))]),
        0.05,
        tolerance=1e-12,
    )
    state, most = stepper.rest(), 0
    for _ in range(2):
        state = stepper(state)
        most = max(most, int(stepper.iterations.min()))
    assert most > 12
    y = state.tip.position[:, 1]
    (slope,) = torch.autograd.grad(y[0], P)
    assert slope[0].item() == pytest.approx(
        ((8 * (y[1] - y[-1]) - (y[2] - y[-2])) / (12 * h)).item(), rel=1e-5
    )


def test_checkpoint_changes_nothing_but_memory():
    """Values and gradients are those of the plain run, to rounding."""

    def run(checkpoint):
        EI = torch.tensor(1.0, requires_grad=True)
        beam = tb.Beam.straight(1.0, 4, tb.Section.from_stiffness(1e4, 1e4, 1.0, EI, 0.2))
        scene = tb.Scene(beam, [tb.TipLoad(force=(0, 1.0, 3.0))])
        sol = tb.simulate(scene, torch.linspace(0, 0.2, 5), step=0.01, checkpoint=checkpoint)
        return (
            sol.tip.position,
            torch.autograd.grad(sol.tip.position.sum(), EI)[0],
            sol.stats.iterations,
        )

    for plain, checkpointed in zip(run(False), run(True), strict=True):
        torch.testing.assert_close(checkpointed, plain, rtol=1e-13, atol=1e-13)


def test_mask_holds_samples_and_leaves_the_others_alone():
    """Samples outside of `active` keep every bit; the others move as if all did."""
    scene = tb.Scene(slender(4), [tb.TipLoad(force=tb.Input("u", 3))])
    stepper = tb.Stepper(scene, 0.01)
    u = torch.tensor([[0, 1.0, 0], [0, 2.0, 0], [0, 0, 3.0]])
    start = stepper(stepper.rest((3,)), u=u)
    all_, some = stepper(start, u=u), stepper(start, u=u, active=torch.tensor([True, False, True]))
    assert torch.equal(some.position[1], start.position[1]) and some.t.tolist() == [
        0.02,
        0.01,
        0.02,
    ]
    assert torch.equal(some.position[[0, 2]], all_.position[[0, 2]])


def test_broken_sample_harms_nobody():
    """One NaN load in a batch: that sample keeps its state and gets a status, the others are
    bit-identical to a batch without it, and all gradients are finite.
    """
    scene = tb.Scene(slender(4), [tb.TipLoad(force=tb.Input("u", 3))])
    stepper = tb.Stepper(scene, 0.01)
    u = torch.tensor([[0, 1.0, 0], [0, math.nan, 0], [0, 0, 3.0]], requires_grad=True)
    state = stepper(stepper.rest((3,)), u=u)
    assert state.status.tolist() == [0, 2, 0] and torch.isfinite(state.position).all()
    fine = stepper(stepper.rest((3,)), u=torch.nan_to_num(u.detach()))
    assert torch.equal(state.position[[0, 2]], fine.position[[0, 2]])
    (gradient,) = torch.autograd.grad(state.tip.position.sum(), u)
    assert torch.isfinite(gradient).all() and (gradient[1] == 0).all()


def test_simulate_says_what_failed():
    """A failure is a status, a reason and a warning; with throw=True a RuntimeError with sample,
    time and advice.
    """

    def force(t):
        return torch.where(t < 0.05, 1.0, math.nan) * torch.tensor([0, 1.0, 0])

    scene = tb.Scene(slender(4), [tb.TipLoad(force=force)])
    with pytest.warns(RuntimeWarning, match=r"t = 0.05 s"):
        sol = tb.simulate(scene, torch.linspace(0, 0.1, 11), step=0.01)
    assert sol.status == 2 and "not a number" in sol.stats.reason[2]
    assert torch.equal(sol.tip.position[-1], sol.tip.position[5])
    with pytest.raises(RuntimeError, match=r"the sample .* stopped after t = 0.05 s"):
        tb.simulate(scene, torch.linspace(0, 0.1, 11), step=0.01, throw=True)


def test_restart_and_files(tmp_path):
    """Two halves of a run joined by a file are the run: a saved state holds everything."""
    scene = tb.Scene(slender(4), [tb.TipLoad(force=(0, 1.0, 0))])
    whole = tb.simulate(scene, [0.0, 0.1, 0.2], step=0.01)
    first = tb.simulate(scene, [0.0, 0.1], step=0.01)
    torch.save(first.state[-1], tmp_path / "state.pt")
    second = tb.simulate(scene, [0.1, 0.2], initial=torch.load(tmp_path / "state.pt"), step=0.01)
    torch.testing.assert_close(second.nodes[-1], whole.nodes[-1], rtol=0, atol=1e-14)


@pytest.mark.parametrize("engine", ["eager", "compiled"])
def test_failed_steps_of_different_lengths_are_made_in_parts(engine):
    """One of many samples, which goes on by itself, and with its own length of step: as alone."""
    section = tb.Section.from_stiffness(EA=4e4, GA=1.5e4, GJ=0.8, EI=1.0, mass=0.2, inertia=5e-6)
    scene = tb.Scene(
        tb.Beam.straight(1.0, 1, section), [tb.TipLoad(force=tb.Input("force", 3))], plane="xy"
    )
    stepper = tb.Stepper(scene, 0.05, halvings=6, engine=engine)
    force, dt = torch.zeros(70, 3), torch.linspace(0.04, 0.05, 70)
    force[:, 1], force[33, 1] = 1.0, 100.0
    state = stepper.advance(stepper.rest((70,)), {"force": force}, dt=dt)
    assert (state.status == 0).all() and stepper.iterations[33] > 2 * stepper.iterations[0]
    alone = stepper.advance(stepper.rest((1,)), {"force": force[33:34]}, dt=dt[33:34])
    torch.testing.assert_close(state.position[33], alone.position[0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("engine", ["eager", "auto"])
def test_a_state_of_other_supports_goes_on(engine):
    """Let go of, or held where nothing did: as many reactions as the scene has supports, from the
    start on, and those of a start that has forgotten its own.
    """
    beam = tb.Beam.straight(0.3, 2, tb.Section.circle(0.01, 1e6, 0.45, 1100.0))
    scenes = [
        tb.Scene(beam, [tb.Gravity([0.0, 0.0, -1.0])], supports=held)
        for held in (None, [tb.Support(0), tb.Support(-1)])
    ]
    for start, scene in ((tb.equilibrium(scenes[1]), scenes[0]), (tb.rest(scenes[0]), scenes[1])):
        count = len(scene.supports)
        run, other = (
            tb.simulate(scene, torch.linspace(0, 0.01, 3), one, step=5e-3, engine=engine).state
            for one in (start, replace(start, reaction=torch.zeros(count, 6)))
        )
        assert run.reaction.shape == (3, count, 6) and run.reaction[-1].abs().max() > 1e-3
        torch.testing.assert_close(run.reaction, other.reaction, rtol=0, atol=1e-12)
        assert tb.Stepper(scene, 5e-3, engine=engine)(start).reaction.shape == (count, 6)


@pytest.mark.parametrize("kind", [tb.Stepper, tb.ExplicitStepper])
def test_a_merged_stepper_is_deprecated_and_steps_as_one_of_the_merged_scene(kind):
    few, up = extend.BatchSubset(torch.tensor([1]), 3), torch.tensor([0.0, 0.0, 1.0])
    forces = up * torch.tensor([[0.1], [0.2], [0.3]])
    scene = tb.Scene(soft_beam(), [tb.TipLoad(force=forces)])
    part = tb.Scene(soft_beam(), [tb.TipLoad(force=-up[None])])
    with pytest.warns(DeprecationWarning, match="merge the scenes"):
        merged = kind(scene, 1e-3).merge(few, kind(part, 1e-3))
    wanted = kind(few.merge(scene, part), 1e-3)
    after = merged(merged.rest()).position
    assert torch.equal(after, wanted(wanted.rest()).position)
    assert (after[1] - after[0])[-1, 2] < 0


def warnings_of(what) -> list[str]:
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        what()
    return [str(w.message) for w in seen]


def explicit(scene, dt):
    return tb.ExplicitStepper(scene, dt, "rk4", form="nodal")


@pytest.mark.parametrize("of", [tb.Stepper, explicit])
def test_a_loop_of_steps_is_warned_once_of_a_failure(of):
    """An input of one sample that is no number: the first step that fails says which sample, when
    and why; the steps that follow, and good ones, say nothing.
    """
    beam = tb.Beam.straight(1.0, 2, tb.Section.from_stiffness(10.0, 4.0, 0.5, 1.0, 0.3, 0.01))
    step = of(tb.Scene(beam, [tb.TipLoad(force=tb.Input("u", 3))]), 0.001)
    state = step.rest((2,))
    good, wrong = torch.zeros(2, 3), torch.tensor([[0.0, 0, 0], [0, 0, math.nan]])

    def loop():
        now = state
        for u in (good, good, wrong, wrong, good):
            now = step(now, u=u)
        assert now.status[0] == 0 and now.status[1] != 0

    (sentence,) = warnings_of(loop)
    assert sentence.startswith("sample 1 (1 of 2) stopped after t = 0.002 s: ")
    assert warnings_of(loop) == []


def test_a_rollout_warns_as_simulate_does():
    """Each once, with one sentence: for many steps in a call, and for the trial step that starts
    generalized alpha.
    """
    force = torch.tensor((0, 0, 1.0))
    late = tb.TipLoad(force=lambda t: torch.where(t < 0.025, 1.0, math.nan) * force)
    scene = tb.Scene(slender(2), [late])
    (said,) = warnings_of(lambda: tb.simulate(scene, torch.linspace(0, 0.05, 6), step=0.01))
    step = tb.Stepper(scene, 0.01)
    assert warnings_of(lambda: tb.rollout(step, step.rest(), 5)) == [said]
    scene = tb.Scene(slender(2), [tb.TipLoad(force=lambda t: torch.full((3,), math.nan))])
    run = dict(step=0.01, method="generalized_alpha")
    assert len(warnings_of(lambda: tb.simulate(scene, torch.linspace(0, 0.05, 6), **run))) == 1
