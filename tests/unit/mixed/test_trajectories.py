"""Trajectories of the mixed forms: stored ones, each other's, their invariants, several turns,
gradients, failures.
"""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.core.status import FAILED
from torchbeam.math import quaternions as quat
from torchbeam.mixed.block import block_rate
from torchbeam.mixed.consistent import consistent_state
from torchbeam.mixed.simulate import simulate_mixed
from torchbeam.mixed.state import Fields, MixedState
from torchbeam.scene.beam import Beam
from torchbeam.scene.effects import Damping, Gravity, Input, TipLoad
from torchbeam.scene.scene import Frame, RootMotion, Scene
from torchbeam.scene.section import Section

SOFT = Section.from_stiffness(20.0, 20.0, 0.5, (0.5, 0.8), 1.0, 0.1)
TIGHT = dict(method="dopri8", rtol=1e-10, atol=1e-11)


def pull(t):
    return torch.stack((0 * t, 0.6 * torch.sin(3 * t), torch.sin(2 * t)))


def soft_scene(elements=2, section=SOFT, effects=None):
    if effects is None:
        effects = (TipLoad(force=pull), TipLoad(moment=(0.05, 0, 0), follower=True))
    return Scene(Beam.straight(1.0, elements, section), effects)


# -- stored trajectories of the same semi-discrete equations
# ---------------------------------------------------------


def stored_section(mass_coupled=False):
    K = torch.diag(torch.tensor([1e3, 400, 400, 0.8, 1, 2]))
    M = torch.diag(torch.tensor([1.0, 1, 1, 0.02, 0.01, 0.01]))
    if mass_coupled:
        for matrix, entries in (
            (K, ((3, 4, 0.3), (0, 5, 5.0))),
            (M, ((1, 3, 0.03), (0, 5, -0.03))),
        ):
            for i, j, value in entries:
                matrix[i, j] = matrix[j, i] = value
    return torch.linalg.inv(K), M


def ramp(t):
    s = torch.clamp(t / 0.2, max=1.0)
    return 1 - (1 - s) ** 2 * (1 + 2 * s)


def stored_cases():
    """A batch: planar ramp, planar step, and the step in 3D on a coupled section."""
    S, M = (
        torch.stack(m)
        for m in zip(stored_section(), stored_section(), stored_section(True), strict=True)
    )
    step = torch.tensor([[0.0, 0, 0], [0, 0, 3], [0, 1, 3]])
    ramped = torch.tensor([[0.0, 0, 3], [0, 0, 0], [0, 0, 0]])
    return Scene(
        Beam.straight(1.0, 4, Section(S, M)),
        (TipLoad(force=step), TipLoad(force=lambda t: ramp(t) * ramped)),
    )


def compare(sol, index, stored):
    """Tip, energies to 1e-8 (at most 5e-11 off at 0.1 s); the root's load to 1e-5 of its size: it
    follows the fast axial oscillation (1e3 rad/s), which both sides carry to their tolerance times
    that frequency.
    """
    n = min(len(sol.t), len(stored["t"]))
    close = dict(rtol=0, atol=1e-8)
    assert_close(sol.state.u_tip[:n, index], torch.tensor(stored["tip_u"])[:n], **close)
    assert_close(sol.state.theta_tip[:n, index], torch.tensor(stored["tip_theta_WM"])[:n], **close)
    assert_close(sol.energy.strain[:n, index], torch.tensor(stored["strain_energy"])[:n], **close)
    assert_close(sol.energy.kinetic[:n, index], torch.tensor(stored["kinetic_energy"])[:n], **close)
    root = -torch.cat(sol.root, -1)[:n, index]
    assert_close(root, torch.tensor(stored["root_internal_load"])[:n], rtol=0, atol=1e-5)


CASES = "ramp_planar_N4", "step_planar_N4", "step_3d_coupled_N4"


@pytest.mark.parametrize("form", ["minimal", pytest.param("block_rate", marks=pytest.mark.long)])
def test_stored_trajectories(reference, form):
    """semidiscrete_trajectories.json, N = 4, to 0.1 s, in the plane and in 3D."""
    stored = reference("semidiscrete_trajectories")["values"]
    sol = simulate_mixed(
        stored_cases(), torch.linspace(0, 0.1, 2), form, method="dopri8", rtol=1e-8, atol=1e-10
    )
    for i, case in enumerate(CASES):
        compare(sol, i, stored[case])
    assert sol.stats.drift is None if form == "minimal" else sol.stats.drift.max() < 1e-8


@pytest.mark.long
def test_stored_trajectories_to_one_second_and_energy_growth(reference):
    """The same to 1 s, in 3D to 0.5 s, where the file ends (energies 3e-10 off, the root's load
    2e-6).

    And the known growth of energy in 3D. On the third sample (a section whose mass couples V with
    Omega) kinetic + strain energy minus the work of the dead load should stay zero; to 1 s it grows
    to 1.1687 of the peak strain energy, as stored, in a time integration accurate to 1e-9. The
    planar step drifts by 0.34 % of it, the stored figure.
    """
    stored = reference("semidiscrete_trajectories")["values"]
    sol = simulate_mixed(
        stored_cases(), torch.linspace(0, 1, 11), "minimal", method="dopri8", rtol=1e-9, atol=1e-10
    )
    work = (sol.state.u_tip * torch.tensor([[0.0, 0, 3], [0, 0, 3], [0, 1, 3]])).sum(-1)
    drift = (sol.energy.kinetic + sol.energy.strain - work)[:, 1:].abs().amax(
        0
    ) / sol.energy.strain[:, 1:].amax(0)
    for i, case in enumerate(CASES):
        compare(sol, i, stored[case])
    assert drift[0] < 0.0035
    assert drift[1].item() == pytest.approx(
        stored[CASES[2]]["energy_drift_full_window_to_t1"], rel=1e-3
    )


# -- the two forms
# --------------------------------------------------------------------------------------------------


def test_forms_agree_along_a_trajectory():
    """Soft section, 3D, dead and follower loads, 20 ms: every quantity to 1e-8 of at most unit size
    (both integrated to 1e-10).
    """
    t = torch.linspace(0, 0.02, 3)
    one, other = (
        simulate_mixed(soft_scene(), t, form, **TIGHT) for form in ("minimal", "block_rate")
    )
    for name in (*Fields._fields, "strain", "position", "velocity", "rotation", "spin", "reaction"):
        assert_close(
            getattr(one.state, name), getattr(other.state, name), rtol=1e-8, atol=1e-8, msg=name
        )
    assert one.stats.drift is None and other.stats.drift.max() < 1e-11


def test_dense_route_gives_the_same_trajectory():
    t = torch.linspace(0, 0.02, 3)
    sweep, dense = (
        simulate_mixed(soft_scene(1), t, "block_rate", solver=s) for s in ("sweep", "dense")
    )
    assert_close(sweep.tip.position, dense.tip.position, rtol=0, atol=1e-12)


def test_consistent_state_satisfies_every_equation():
    """Any u, theta, V, Omega; loads, frame and root in motion: residual below 1e-12, and both forms
    have its rates.
    """
    from tests.cases.mixed_cases import random_scene
    from torchbeam.mixed import minimal

    scene, at = random_scene(3, (4,)), torch.tensor(0.4)
    state = consistent_state(scene, *0.4 * torch.randn(4, 4, 3, 3), t=at)
    system = block_rate(scene, state, at)
    assert system.drift.abs().max() < 1e-12
    x = state.fields
    short = minimal.rates(system.model, at, x.u, x.theta, x.V, x.Omega)
    long = system.solve()
    assert_close(short, torch.cat((long[..., :18], long[..., 36:54]), -1), rtol=1e-11, atol=1e-11)


def test_projection_at_every_output():
    """A short motion at a loose tolerance: what drifts is put back by project=True, and it is the
    same motion.
    """
    section = Section.from_stiffness(8.0, 5.0, 0.4, (0.5, 0.8), 1.0, 0.3)
    scene = soft_scene(1, section, (TipLoad(force=lambda t: 0.5 * pull(t)),))
    t = torch.linspace(0, 1, 5)
    options = dict(rtol=1e-3, atol=1e-5)
    free, held = (
        simulate_mixed(scene, t, "block_rate", project=project, **options)
        for project in (False, True)
    )
    assert free.stats.drift > 1e-7 and held.stats.drift < 1e-3 * free.stats.drift
    assert_close(held.tip.position, free.tip.position, rtol=0, atol=1e-2)


def test_restart_continues():
    """From a state in the middle, made consistent again: the same to the drift it had
    (1e-9 at these steps).
    """
    t = torch.linspace(0, 0.1, 21)
    whole = simulate_mixed(soft_scene(), t, "block_rate", method="rk4")
    rest = simulate_mixed(soft_scene(), t[10:], "block_rate", initial=whole.state[10], method="rk4")
    assert isinstance(whole.state[10], MixedState)
    assert_close(rest.tip.position, whole.tip.position[10:], rtol=0, atol=1e-8)


# -- rotations
# --------------------------------------------------------------------------------------------------


def spun(t, turns=2.5, end=5.0):
    s = t / end
    return 2 * torch.pi * turns * s**3 * (10 - 15 * s + 6 * s * s) * torch.tensor([1.0, 2, 2]) / 3


@pytest.mark.long
def test_several_turns_out_of_plane():
    """A soft beam whose root turns two and a half times about an oblique axis in 5 s: elements pass
    into their other chart (|theta| = 6) again and again, at different instants. The same problem in
    a frame that turns with the root never leaves its chart; the two meet within the mesh's error (3
    % of the length, with a tip that moves by half of it), and the block rate form follows the
    minimal one.
    """
    section = Section.from_stiffness(60.0, 30.0, 3.0, (3.0, 4.0), 1.0, 0.3)
    t = torch.linspace(0, 5, 41)

    def omega(t):
        return torch.func.jvp(spun, (t,), (torch.ones_like(t),))[1]

    beam = Beam.straight(1.0, 2, section)
    turned = simulate_mixed(
        Scene(beam, root=RootMotion(rotation=spun)), t, "minimal", rtol=1e-5, atol=1e-6
    )
    framed = simulate_mixed(
        Scene(beam, frame=Frame(angular_velocity=omega)), t, "minimal", rtol=1e-5, atol=1e-6
    )
    R = quat.matrix(quat.exponential(torch.stack([spun(s) for s in t])))
    seen = (R @ framed.tip.position[..., None])[..., 0]
    assert turned.state.theta.norm(dim=-1).max() < 8
    assert (framed.tip.position - torch.tensor([1.0, 0, 0])).norm(dim=-1).max() > 0.25
    assert_close(turned.tip.position, seen, rtol=0, atol=0.03)

    one = Beam.straight(1.0, 1, section)
    scene, t = Scene(one, root=RootMotion(rotation=spun)), t[:25]
    forms = [simulate_mixed(scene, t, form) for form in ("minimal", "block_rate")]
    assert_close(forms[0].tip.position, forms[1].tip.position, rtol=0, atol=1e-5)


def test_frame_velocity_is_a_change_of_observer():
    """A frame that moves steadily changes nothing but the velocities: exact (Galilei)."""
    t = torch.linspace(0, 0.03, 4)
    still = simulate_mixed(soft_scene(), t, "minimal", **TIGHT)
    scene = Scene(soft_scene().beam, soft_scene().effects, frame=Frame(velocity=(1.0, 2, -1)))
    moving = simulate_mixed(scene, t, "minimal", **TIGHT)
    assert_close(moving.tip.position, still.tip.position, rtol=0, atol=1e-8)
    assert_close(
        moving.tip.velocity - still.tip.velocity,
        torch.tensor([1.0, 2, -1]).expand(4, 3),
        rtol=0,
        atol=1e-6,
    )


def test_free_fall_of_the_reaction():
    """Gravity on a beam at rest: at t = 0 nothing has moved, and elements fall freely but for the
    clamp.
    """
    state = consistent_state(soft_scene(4, effects=(Gravity((0.0, 0, -9.81)),)))
    assert_close(state.V_dot[..., 2].mean(), torch.tensor(-9.81), rtol=1e-12, atol=0)
    assert_close(state.root.force, torch.zeros(3), rtol=0, atol=1e-12)


# -- damping, inputs, gradients, failures
# ----------------------------------------------------------------------------


def test_minimal_form_takes_damping():
    """Energy of a released beam falls with Kelvin-Voigt damping, one value and six alike when
    equal.
    """
    start = dict(V=torch.tensor([[0.0, 0, 0.1], [0, 0, 0.3]]))
    t = torch.linspace(0, 1, 11)
    energies = []
    for tau, until in ((0.1, 11), ((0.1,) * 6, 3)):
        scene = soft_scene(effects=(Damping(tau),))
        sol = simulate_mixed(
            scene, t[:until], "minimal", initial=consistent_state(scene, **start), rtol=1e-5
        )
        energies.append(sol.energy.kinetic + sol.energy.strain)
    assert_close(energies[0][:3], energies[1], rtol=1e-6, atol=1e-9)
    assert (energies[0].diff() < 0).all() and energies[0][-1] < 0.5 * energies[0][0]


def test_a_root_whose_motion_alone_is_a_batch():
    """Each sample as alone: the scene has no batch axes, the function of t has."""
    turn = torch.tensor([[0, 0.1, 0], [0, 0, 0.2]])

    def scene(turn):
        return Scene(
            Beam.straight(1.0, 2, SOFT), root=RootMotion(rotation=lambda t: turn * torch.sin(t))
        )

    for form in ("minimal", "block_rate"):
        both = tb.simulate(scene(turn), [0.0, 0.01, 0.02], form=form, method="rk4")
        assert both.nodes.shape == (3, 2, 3, 3)
        alone = torch.stack(
            [
                tb.simulate(scene(one), [0.0, 0.01, 0.02], form=form, method="rk4").nodes
                for one in turn
            ],
            1,
        )
        assert_close(both.nodes, alone, rtol=0, atol=1e-12)
    zero = torch.zeros(2, 3)
    assert tb.consistent_state(scene(turn), zero, zero, zero, zero, t=0.3).position.shape == (
        2,
        3,
        3,
    )


def test_gradient_by_a_damping_that_is_zero():
    """tau of six, two of them 0: the derivative by each against one-sided differences, 1e-3 off at
    most (of the largest).
    """
    section = Section.from_stiffness(1e3, 500.0, 10.0, (20.0, 30.0), 1.0, 0.1)
    tau = torch.tensor([1e-3, 0, 1e-3, 1e-3, 1e-3, 0])

    def tip(tau):
        scene = Scene(
            Beam.straight(1.0, 2, section), (Damping(tau, six=True), Gravity((1.0, 2.0, -9.81)))
        )
        return (
            tb.simulate(scene, torch.linspace(0, 0.005, 6), form="minimal", method="rk4")
            .nodes[-1, ..., -1, :]
            .sum(-1)
        )

    leaf = tau.clone().requires_grad_()
    (slope,) = torch.autograd.grad(tip(leaf), leaf)
    steps = 1e-7 * torch.eye(6)
    wanted = (tip(tau + steps) - tip(tau)) / 1e-7
    assert_close(slope, wanted, rtol=0, atol=1e-3 * slope.abs().max().item())


def test_input_is_held_and_batches():
    scene = soft_scene(effects=(TipLoad(force=Input("f", 3)),))
    force = torch.tensor([[0.0, 0, 0.1], [0, 0.2, 0]])
    t = torch.linspace(0, 0.2, 21)
    together = simulate_mixed(scene, t, "block_rate", inputs={"f": force}, method="rk4")
    alone = simulate_mixed(scene, t, "block_rate", inputs={"f": force[1]}, method="rk4")
    assert together.tip.position.shape == (21, 2, 3)
    assert_close(together.tip.position[:, 1], alone.tip.position, rtol=0, atol=1e-13)
    with pytest.raises(ValueError, match="input 'f' is missing"):
        simulate_mixed(scene, t, "block_rate")


def final_height(EI, form, **options):
    section = Section.from_stiffness(20.0, 20.0, 0.5, EI, 1.0, 0.1)
    scene = soft_scene(
        1, section, (TipLoad(force=lambda t: torch.stack((0 * t, 0 * t, torch.sin(2 * t)))),)
    )
    return simulate_mixed(scene, torch.linspace(0, 0.2, 21), form, **options).tip.position[
        -1, ..., 2
    ]


@pytest.mark.parametrize("form", ["minimal", pytest.param("block_rate", marks=pytest.mark.long)])
def test_gradients(form):
    """d(tip height)/d(EI) by backprop through rk4, by the continuous adjoint (the scene's tensors
    found by themselves), which is off by what its own steps leave, of fourth order, and by forward
    mode, against central differences.
    """
    rk4 = dict(method="rk4", options=dict(step_size=5e-3))
    EI, one = 0.5 + 1e-4 * torch.tensor([0.0, 1.0, -1.0]), torch.ones(3)
    height, forward = torch.func.jvp(lambda v: final_height(v, form, **rk4), (EI,), (one,))
    expected = (height[1] - height[2]) / 2e-4
    assert_close(forward[0], expected, rtol=1e-6, atol=0)
    for adjoint in (False, True):
        leaf = EI[0].clone().requires_grad_()
        (gradient,) = torch.autograd.grad(final_height(leaf, form, adjoint=adjoint, **rk4), leaf)
        assert_close(gradient, expected, rtol=2e-5 if adjoint else 1e-6, atol=0)


@pytest.mark.parametrize("form", ["nodal", "minimal"])
def test_adjoint_by_what_a_function_of_time_reads_later(form):
    """A force that is another tensor's after half of the time: the continuous adjoint has its
    derivative too, that of backprop to the steps' own error.
    """
    early, late = (torch.tensor(0.02, requires_grad=True) for _ in range(2))
    force = TipLoad(force=lambda t: torch.stack((0 * t, 0 * t, (late if t > 0.002 else early) * t)))
    section = Section.from_stiffness(EA=200.0, GA=80.0, GJ=0.015, EI=0.02, mass=0.3, inertia=1e-3)
    scene = Scene(Beam.straight(0.3, 1, section), [force])
    options = dict(form=form, method="rk4", options=dict(step_size=5e-4))
    ends = (
        tb.simulate(scene, [0, 0.002, 0.004], adjoint=adjoint, **options).nodes[-1].sum()
        for adjoint in (False, True)
    )
    assert_close(*(torch.autograd.grad(end, (early, late)) for end in ends), rtol=1e-3, atol=0)


def test_adjoint_of_a_damped_beam_warns():
    """Strong damping: integrated back the state runs away, and the warning says by how much."""
    scene = soft_scene(
        1, effects=(TipLoad(force=pull), Damping(torch.tensor(0.2, requires_grad=True)))
    )
    with pytest.warns(
        UserWarning, match=r"continuous adjoint cannot be trusted here: .* misses itself by"
    ):
        simulate_mixed(
            scene, torch.tensor([0.0, 0.5]), "minimal", rtol=1e-4, atol=1e-5, adjoint=True
        )


def test_failed_sample_keeps_its_neighbours():
    """A load that becomes infinite at 0.1 s in one sample: status, last good state, and an
    untouched neighbour.
    """
    load = TipLoad(
        force=lambda t: torch.stack((torch.zeros(3), torch.tensor([0.0, 0, 1]) / (t < 0.1)))
    )
    t = torch.linspace(0, 0.2, 21)
    with pytest.warns(RuntimeWarning, match=r"sample 1 \(1 of 2\) after t = 0\.09.*nodal form"):
        sol = simulate_mixed(soft_scene(1, effects=(load,)), t, "minimal", method="rk4")
    assert sol.status.tolist() == [0, FAILED] and FAILED in sol.stats.reason
    assert torch.isfinite(sol.nodes).all()
    with pytest.raises(RuntimeError, match="failed on the sample after"):
        simulate_mixed(
            soft_scene(1, effects=(TipLoad(force=(0.0, 0, 1)),)),
            torch.linspace(0, 100, 11),
            "minimal",
            method="rk4",
        )


def test_what_is_refused():
    scene, t = soft_scene(), torch.tensor([0.0, 0.1])
    for options, sentence in (
        (dict(form="nodal"), "'block_rate', 'minimal' are there"),
        (dict(form="minimal", project=True), "only 'block_rate' has something to project"),
        (dict(form="block_rate", solver="magic"), "'sweep', 'dense' are there"),
        (dict(form="minimal", initial=3), "the mixed forms want a MixedState"),
        (dict(form="minimal", method="magic"), "torchdiffeq has"),
    ):
        with pytest.raises(ValueError, match=sentence):
            simulate_mixed(scene, t, **options)
    with pytest.raises(
        ValueError, match=r"theta of shape \(5, 3\) was given; \(\.\.\., 2, 3\) is wanted"
    ):
        consistent_state(scene, theta=torch.zeros(5, 3))


@pytest.mark.parametrize("form", ["minimal", "block_rate"])
def test_instants_of_samples_make_a_batch(form):
    """A scene and a start of one sample, from two instants: two samples, each as alone."""
    scene = soft_scene(effects=(TipLoad(force=(0, 0.6, 0.1)),))
    run = dict(form=form, method="rk4", options={"step_size": 5e-4})
    both, alone = (
        tb.simulate(scene, [0.0, 1e-3], begin=begin, **run).tip.position
        for begin in (torch.tensor([0.5, 2.0]), None)
    )
    assert_close(both, alone[:, None].expand(2, 2, 3), rtol=1e-12, atol=1e-14)
