"""The index-reduced rows against the forward-mode derivative of the undifferentiated equations; the
two routes to the rates against each other; the rows of the derivation's draft, which fail.
"""

import math

import numpy
import pytest
import torch
from torch.testing import assert_close

from tests.cases.mixed_cases import mass, random_chain, random_fields, random_scene, spd, wave
from tests.cases.modules import ROOT, module_of
from torchbeam.math import wiener_milenkovic as rot
from torchbeam.mixed import rates, residuals
from torchbeam.mixed.block import block_rate
from torchbeam.mixed.consistent import consistent_state
from torchbeam.mixed.model import MixedModel, check_times
from torchbeam.mixed.state import pack, unpack
from torchbeam.scene.beam import Beam
from torchbeam.scene.effects import (
    Actuation,
    Along,
    Damping,
    Drag,
    Gravity,
    Input,
    LineLoad,
    Load,
    MassDamping,
    PointMass,
    RootSpring,
    Spring,
    TipLoad,
)
from torchbeam.scene.scene import Frame, Scene
from torchbeam.scene.section import Section

t = torch.tensor(0.7)
DEAD = (TipLoad(force=wave(4), moment=wave(4)), LineLoad(force=wave(), follower=True))
# fmt: off
MOVED = (Drag(2.0, torch.rand(4), tangential=0.1, flow=lambda x, t: torch.sin(x + t)),
         MassDamping(0.3),
         Spring(1, 2.0, to=wave(4), length=0.1), Spring(-1, torch.rand(4), to=(0.1, 0.2, 0.3)),
         LineLoad(force=Along(lambda s, t: torch.stack((s * t, s, t * s * s), -1)), follower=True),
         Load(lambda x, R, v, w,
              t: (t * R[..., 0] * (v * w).sum(-1, keepdim=True), torch.linalg.cross(x, v)),
              node=None))
# fmt: on


def vector(x):
    return pack(x[:8], x[8:])


def rates_with_random_highest(chain, x, s):
    """Any x' that satisfies the kinematic rows: these may use u', theta', V', Omega'."""
    f = unpack(torch.randn_like(vector(x)), chain.count)
    return pack(
        (s.k.u_dot, s.k.theta_dot, f.F, f.M, x.V_dot, x.Omega_dot, f.V_dot, f.Omega_dot),
        (
            f.F_root,
            f.M_root,
            s.u_nodes[..., -1, :] if chain.shifting else f.u_tip,
            s.theta_nodes[..., -1, :],
        ),
    )


@pytest.mark.parametrize("size, effects", [(0.7, None), (3.0, DEAD), (0.7, MOVED)])
@pytest.mark.parametrize("N", [1, 2, 5])
def test_every_row_is_the_derivative_of_the_residual(N, size, effects):
    """A x' - b = d/dt residual at 4 random states with random SPD compliance and mass, C^ab, frame
    and root in motion, dead and follower loads everywhere, all functions of t; or loads that read
    position, velocity and spin. Random |theta| of about 5 (size 3) puts neighbours into different
    charts; there the loads that turn with inner nodes are left out, whose rotation has two
    expressions off the constraint. 1e-10 of the row's largest value.
    """
    chain, x = random_chain(N, (4,), effects=effects), random_fields(N, (4,), size=size)
    s = rates.terms(chain, t, x)
    assert (s.jump is not None) == (size > 1 and N > 1)
    A, b = rates.block_system(chain, x, s)
    x_dot = rates_with_random_highest(chain, x, s)
    _, expected = torch.func.jvp(
        lambda t, v: residuals.residual(chain, t, unpack(v, N)).flatten(-3),
        (t, vector(x)),
        (torch.ones_like(t), x_dot),
    )
    left = (A @ x_dot[..., None])[..., 0] - b
    assert_close(
        left[..., : 12 * (N + 1)], expected, rtol=0, atol=1e-10 * expected.abs().max().item()
    )
    assert_close(left[..., 12 * (N + 1) :], torch.zeros(4, 12 * N), rtol=0, atol=1e-12)


def test_kinematic_rows_solve_f_P_and_f_H():
    chain, x = random_chain(3, (4,)), random_fields(3, (4,), size=2.0)
    e, s = residuals.element(chain, x), rates.terms(chain, t, x)
    v, omega = chain.frame(t)
    v_at_element = v + torch.linalg.cross(omega.expand_as(chain.middle), chain.middle)
    omega = omega.expand_as(x.u)
    zero = torch.zeros(4, 3, 3)
    assert_close(residuals.f_P(e, x, s.k.u_dot, v_at_element, omega), zero, rtol=0, atol=1e-13)
    assert_close(residuals.f_H(e, x, s.k.theta_dot, omega), zero, rtol=0, atol=1e-13)


def test_gravity_rows():
    """The weight's moment turns with an offset section: its rate is in the rows too
    (frame a at rest).
    """
    chain = random_chain(3, (4,), effects=(Gravity(wave()),), turning_frame=False)
    x = random_fields(3, (4,))
    s = rates.terms(chain, t, x)
    A, b = rates.block_system(chain, x, s)
    x_dot = rates_with_random_highest(chain, x, s)
    _, expected = torch.func.jvp(
        lambda t, v: residuals.residual(chain, t, unpack(v, 3)).flatten(-3),
        (t, vector(x)),
        (torch.ones_like(t), x_dot),
    )
    assert_close(((A @ x_dot[..., None])[..., 0] - b)[..., :48], expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    "N, size, bound", [(1, 0.7, 1e-14), (2, 3.0, 1e-13), (5, 3.0, 1e-13), (20, 0.7, 1e-11)]
)
def test_sweep_equals_dense(N, size, bound):
    """Relative to the largest rate; the bound grows with the condition number (2.7e4 at N = 20)."""
    chain, x = random_chain(N, (3,)), random_fields(N, (3,), size=size)
    s = rates.terms(chain, t, x)
    sweep, dense = rates.sweep(chain, x, s), rates.solve_scaled(*rates.block_system(chain, x, s))
    assert_close(sweep, dense, rtol=0, atol=bound * dense.abs().max().item())


def test_scaling_saves_a_badly_scaled_matrix():
    """A steel rod (EA = 2e8 N, EI = 20 N m^2): rates solve the rows to rounding, scaled row by
    row.
    """
    section = Section.rectangle(0.02, 0.01, 200e9, 0.3, 7800.0)
    scene = Scene(Beam.straight(1.0, 4, section), (TipLoad(force=(0.0, 1, 3)),))
    system = block_rate(scene, consistent_state(scene, theta=torch.rand(4, 3) * 1e-3))
    dense, sweep = system.solve("dense"), system.solve("sweep")
    row = system.A.abs().amax(-1)
    assert (((system.A @ dense - system.b) / row).abs().max() / dense.abs().max()).item() < 1e-13
    for one, other in zip(unpack(dense, 4), unpack(sweep, 4), strict=True):
        assert_close(one, other, rtol=0, atol=1e-9 * other.abs().max().item() + 1e-9)


def test_one_element_stands_as_printed():
    """N = 1: 36 x 36, twelve block columns in the order of the derivation, 34 blocks of the
    corrected matrix.
    """
    system = block_rate(random_scene(1), torch.randn(36), t)
    assert (
        system.A.shape == (36, 36) and system.b.shape == (36,) and system.drift.shape == (2, 4, 3)
    )
    assert system.columns == (
        "u_1", "theta_1", "F_1", "M_1", "V_1", "Omega_1", "V_dot_1", "Omega_dot_1", "F*_1", "M*_1",
        "u^_2", "theta^_2",
    )  # fmt: skip
    assert system.rows[:4] == ("f_u node 1", "f_psi node 1", "f_F node 1", "f_M node 1")
    assert len(system.blocks) == 34
    R = rot.turn(system.x.theta[0]) @ system.model.Cab[0]
    assert_close(system.blocks["f_u node 1", "F_1"], -R)
    assert_close(system.blocks["f_F node 2", "u^_2"], torch.eye(3))
    for i, row in enumerate(system.rows):
        for j, column in enumerate(system.columns):
            inside = system.A[3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
            assert_close(
                inside, system.blocks.get((row, column), torch.zeros(3, 3)), rtol=0, atol=0
            )


def example():
    return module_of(ROOT / "examples" / "block_rate_matrix.py")


def test_printed_rows_fail():
    """Rows 3 to 8 of the draft's matrix are violated by the true rates by order one, its other rows
    hold; the corrected rows hold all; and both matrices have full rank.
    """
    shown = example()
    assert shown.WRONG_ROWS == [3, 4, 5, 6, 7, 8] and shown.RANKS == [36, 36]
    assert (shown.printed_error[2:8] > 0.1).all()
    assert (
        shown.corrected_error.max() < 1e-12
        and shown.printed_error[[0, 1, 8, 9, 10, 11]].max() < 1e-12
    )


def test_errata_before_the_matrix():
    """The draft's governing equations, first differentiated list and isolated list, entry by entry
    of the table in docs/derivation.md: violated by order one as printed at a consistent state and
    its rates, satisfied as corrected.
    """
    scene = random_scene(1, effects=DEAD[:1], seed=5)
    scene = Scene(scene.beam, (TipLoad(force=wave(), moment=wave()),), scene.frame, scene.root)
    state = consistent_state(scene, *0.5 * torch.randn(4, 1, 3), t=t)
    system = block_rate(scene, state, t)
    x, s, x_dot = system.x, system.terms, unpack(system.solve(), 1)
    e = s.e
    assert system.drift.abs().max() < 1e-12

    governing = residuals.f_F(+1, e, x), residuals.f_M(+1, e, x)
    # zero: the corrected rows, with everything on the left
    right = system.A @ system.solve() - system.b
    row = dict(enumerate(right.unflatten(0, (12, 3)), 1))
    root_u, root_theta = s.u_nodes[0], s.theta_nodes[0]
    tip_force, tip_moment = s.nodal[1, :3], s.nodal[1, 3:]
    M21 = e.h * e.R @ system.model.Mass[..., 3:, :3]
    M22 = e.h * e.R @ system.model.Mass[..., 3:, 3:]
    S21, S22 = e.h * e.R @ system.model.S[..., 3:, :3], e.h * e.R @ system.model.S[..., 3:, 3:]
    swapped = (S21 - M21)[0] @ x_dot.V_dot[0] + (S22 - M22)[0] @ x_dot.Omega_dot[0]
    printed_and_right = {
        "governing, tip, u": (governing[0][0] - x.u_tip, governing[0][0] + x.u_tip),
        "governing, tip, theta": (governing[1][0] - x.theta_tip, governing[1][0] + x.theta_tip),
        "first list, 5": (row[5] + tip_force - x_dot.F_root, row[5]),
        "first list, 6": (row[6] + tip_moment - x_dot.M_root, row[6]),
        "first list, 7": (row[7] - x_dot.u_tip - root_u, row[7]),
        "first list, 8": (row[8] - x_dot.theta_tip - root_theta, row[8]),
        "isolated, 3": (row[3] + root_u, row[3]),
        "isolated, 4": (row[4] + root_u, row[4]),
        "isolated, 6": (row[6] + swapped, row[6]),
    }
    for where, (printed, corrected) in printed_and_right.items():
        assert printed.abs().max() > 0.05, where
        assert corrected.abs().max() < 1e-11, where


def test_sample_alone_equals_sample_in_a_batch():
    scene = random_scene(3, (5,), effects=(TipLoad(force=torch.randn(3), follower=True),))
    x = torch.randn(5, 84) / 2
    together = block_rate(scene, x, t)
    for method in ("sweep", "dense"):
        one = Scene(
            Beam.from_nodes(
                scene.beam.nodes[2],
                [Section(scene.beam.compliance[2, i], scene.beam.mass[2, i]) for i in range(3)],
            ),
            scene.effects,
        )
        moving = Scene(scene.beam, scene.effects)
        alone = block_rate(one, x[2], t).solve(method)
        assert_close(block_rate(moving, x, t).solve(method)[2], alone, rtol=1e-10, atol=1e-10)
    assert together.solve().shape == (5, 84)


def test_rates_of_loads():
    """A load that is constant, or an `Input`, has no rate; a ramp and a piecewise-linear history
    have their slopes.
    """
    times = torch.tensor([0.0, 1, 2, 4])
    values = torch.tensor([[0.0, 0, 0], [0, 0, 2], [0, 1, 2], [0, 1, 0]])

    def history(t):
        i = torch.searchsorted(times, t.detach(), right=True).clamp(1, 3)
        return values[i - 1] + (values[i] - values[i - 1]) * (
            (t - times[i - 1]) / (times[i] - times[i - 1])
        )

    beam = Beam.straight(1.0, 2, Section(spd(), mass()))
    x = torch.randn(60) / 2
    for load, inputs, at, slope in (
        (TipLoad(force=(1.0, 2, 3)), {}, 0.5, (0.0, 0, 0)),
        (TipLoad(force=Input("f", 3)), {"f": torch.randn(3)}, 0.5, (0.0, 0, 0)),
        (
            TipLoad(force=Input("f", 3)),
            {"f": lambda t: torch.stack((t * t, 0 * t, t))},
            0.5,
            (1.0, 0, 1),
        ),
        (TipLoad(force=history), {}, 0.5, (0.0, 0, 2)),
        (TipLoad(force=history), {}, 1.5, (0.0, 1, 0)),
        (TipLoad(force=history), {}, 3.0, (0.0, 0, -1)),
    ):
        rate = block_rate(Scene(beam, (load,)), x, at, inputs).terms.nodal
        assert_close(rate[2, :3], torch.tensor(slope), rtol=0, atol=1e-14)
        assert (rate[:2] == 0).all() and (rate[2, 3:] == 0).all()


def test_load_that_leaves_torch_is_refused():
    """math.sin(t) has a value but no rate; refused at the door instead of integrated with a rate of
    zero.
    """
    scene = Scene(
        Beam.straight(1.0, 2, Section(spd(), mass())),
        (TipLoad(force=lambda t: [0, 0, math.sin(t)]),),
    )
    with pytest.raises(
        ValueError, match=r"TipLoad changes in time but has no rate in torch; .*math\.sin"
    ):
        check_times(MixedModel(scene, "block_rate"), torch.linspace(0, 1, 5))


@pytest.mark.parametrize(
    "name, load, matches",
    [
        (
            "Drag",
            lambda sin: Drag(1.0, 0.5, flow=lambda r, t: (0 * r[..., 0], 0.5, sin(t))),
            "Drag",
        ),
        (
            "Load",
            lambda sin: Load(lambda r, R, v, w, t: ((0.0, 0.0, sin(t)), None), node=None),
            "Load",
        ),
        (
            "at a node",
            lambda sin: Load(lambda r, R, v, w, t: ((0.0, 0.0, sin(t)), None), node=-1, of=()),
            "Load",
        ),
        ("Along", lambda sin: LineLoad(force=Along(lambda s, t: (0 * s, 0.0, sin(t)))), "LineLoad"),
    ],
)
def test_functions_of_more_than_time_are_looked_at(name, load, matches):
    """Of place, or of the motion: those that have a rate are taken, those that left torch are
    refused.
    """
    times = torch.linspace(0, 1, 5)
    beam = Beam.straight(1.0, 2, Section(spd(), mass()))
    check_times(MixedModel(Scene(beam, (load(torch.sin),)), "block_rate"), times)
    for sin in (math.sin, lambda t: numpy.sin(t.numpy())):
        with pytest.raises(
            ValueError, match=f"{matches} (changes in time but )?has no rate in torch"
        ):
            check_times(MixedModel(Scene(beam, (load(sin),)), "block_rate"), times)


def test_scenes_without_this_form_are_refused():
    beam = Beam.straight(1.0, 2, Section.from_stiffness(1.0, math.inf, 1.0, 1.0, 1.0, 0.1))
    with pytest.raises(
        ValueError,
        match=r"compliance S .* rigid in shear y, shear z; .*'midpoint' of the nodal form",
    ):
        MixedModel(Scene(beam), "block_rate")
    beam = Beam.straight(1.0, 2, Section.from_stiffness(1.0, 1.0, 1.0, 1.0, 1.0))
    with pytest.raises(
        ValueError,
        match=r"mass must not be singular .*no rotary inertia: its block of Omega.*nodal form",
    ):
        MixedModel(Scene(beam), "minimal")
    singular = torch.diag(torch.ones(6)).index_put(
        (torch.tensor([3, 4]), torch.tensor([4, 3])), torch.tensor(1.0)
    )
    with pytest.raises(ValueError, match=r"compliance S must not be singular"):
        MixedModel(Scene(Beam.straight(1.0, 2, Section(singular, torch.eye(6)))), "minimal")
    beam = Beam.straight(1.0, 2, Section(torch.eye(6), torch.eye(6)))
    with pytest.raises(ValueError, match=r"Damping .* rows f_F and f_M .* form='minimal' takes it"):
        MixedModel(Scene(beam, (Damping(0.1),)), "block_rate")
    with pytest.raises(ValueError, match="Gravity in a frame with an angular velocity"):
        MixedModel(
            Scene(beam, (Gravity((0, 0, -9.81)),), Frame(angular_velocity=(0.0, 0, 1))), "minimal"
        )
    for effect in (
        Spring(-1, 1.0, to=(0, 0, 0), damping=1.0),
        RootSpring((1.0, 1.0)),
        PointMass(1.0),
        Actuation((0, 0, 1.0)),
    ):
        with pytest.raises(
            ValueError,
            match=f"{type(effect).__name__} was given for form='block_rate', which has no place",
        ):
            MixedModel(Scene(beam, (effect,)), "block_rate")
    with pytest.raises(ValueError, match="Drag in a frame with an angular velocity"):
        MixedModel(
            Scene(beam, (Drag(1.0, 1.0, flow=(1.0, 0, 0)),), Frame(angular_velocity=(0.0, 0, 1))),
            "minimal",
        )
    with pytest.raises(
        ValueError,
        match=r"a state of shape \(36,\) was given; a MixedState or \(\.\.\., 60\) is wanted",
    ):
        block_rate(Scene(beam), torch.zeros(36))
    with pytest.raises(ValueError, match="'sweep' or 'dense' is wanted"):
        block_rate(Scene(beam), torch.zeros(60)).solve("magic")
