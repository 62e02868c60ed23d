"""Equilibrium against closed forms, beside the cases of the verification table (`test_cases`).
Every load value is one sample of one batch.

Elements are one-point and of second order: halving them divides the error by four. Tolerances on
the observed order are 0.1 (higher terms at N = 8); tolerances on the error at N = 16 are the
measured one plus a tenth.
"""

import math
import warnings

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from studies.verification.statics import follower, heavy, roll_up
from tests.cases.nodal_cases import orders

INF = math.inf
MESHES = (8, 16, 32)


def section(EA=INF, GA=INF, EI=1.0, GJ=1.0, mass=1.0):
    """Inextensible and unshearable unless said otherwise: what the elastica is, exactly."""
    return tb.Section.from_stiffness(EA=EA, GA=GA, GJ=GJ, EI=EI, mass=mass, inertia=0.01)


def cantilever(N, *effects, of=None, L=1.0, order=1):
    return tb.Scene(tb.Beam.straight(L, N, of or section(), order=order), effects)


def along_z(values):
    return torch.stack((0 * values, 0 * values, values), -1)


def column(values, *names):
    return torch.tensor([[v[name] for name in names] for v in values])


def tip_errors(solve, want):
    """Largest tip error over the batch on each mesh."""
    return torch.tensor([(solve(N) - want).norm(dim=-1).max() for N in MESHES])


def second_order(errors, at_16):
    assert errors[1] < 1.1 * at_16
    assert_close(orders(errors), torch.full((2,), 2.0), rtol=0, atol=0.1)


@pytest.mark.parametrize(
    "tips, at_8",
    [(follower, 5.5e-4), (roll_up, 2.0e-4), (heavy, 7.4e-5)],
    ids=lambda x: str(x)[:25],
)
def test_quadratic_elements_are_of_fourth_order(tips, at_8):
    """Tip error of 4 and of 8 elements of order 2: it falls by 2^3.7 and more (3.72, 3.94, 3.72;
    3.93 to 3.99 from 8 to 16), and eight leave a 2.4th (heavy) to a 13th (follower) of the error of
    sixteen linear ones.
    """
    errors = [(x - y).norm(dim=-1).max() for x, y in (tips(N, order=2) for N in (4, 8))]
    assert errors[1] < 1.02 * at_8 and orders(torch.stack(errors)) > 3.7


@pytest.mark.parametrize("slenderness", [1e2, 1e4])
def test_quadratic_elements_do_not_lock(slenderness):
    """Quarter circle, radius 1, radial tip force: pi P R^3/(4 EI) of bending. Four elements leave
    2.65e-4 whatever the slenderness, sqrt(EA/EI) R; shear and stretch themselves count for 3.5e-4
    at 1e2.
    """
    S = slenderness**2
    beam = tb.Beam.arc(1.0, math.pi / 2, 4, section(EA=S, GA=S / 2.5), order=2)
    tip = (
        tb.equilibrium(tb.Scene(beam, [tb.TipLoad(force=(1e-6, 0, 0))], small=True)).tip.position
        - beam.nodes[-1]
    )
    more = math.pi / 4 * 1e-6 * (1 / S + 2.5 / S)
    assert_close(tip[0], torch.tensor(math.pi / 4 * 1e-6 + more), rtol=2.7e-4, atol=0)


def test_rolled_up_by_an_end_moment():
    """Curvature is exact on any mesh: eight elements close to a full circle, to rounding."""
    load = tb.TipLoad(moment=(0.0, 0.0, 2 * math.pi))
    state = tb.equilibrium(cantilever(8, load, of=section(1e3, 5e2)))
    assert_close(state.tip.position, torch.zeros(3), rtol=0, atol=1e-13)
    assert_close(state.stress[:, 5], torch.full((8,), 2 * math.pi), rtol=1e-12, atol=0)


def test_roll_up_gradient(reference):
    """d(tip)/d(lam) of the same (reference: 1e-11), in forward mode: second order, 3.7e-3 L at
    N = 16.
    """
    values = reference("end_moment_rollup")["values"]
    lam, dx, dy = column(values, "lam", "dx_dlam_over_L", "dy_dlam_over_L").unbind(-1)

    def solve(N):
        scene = lambda lam: cantilever(N, tb.TipLoad(moment=along_z(math.pi * lam)))  # noqa: E731
        return torch.func.jvp(
            lambda lam: tb.equilibrium(scene(lam)).tip.position, (lam,), (torch.ones_like(lam),)
        )[1]

    second_order(tip_errors(solve, torch.stack((dx, dy, 0 * dx), -1)), 3.7e-3)


def test_infinite_stiffness_is_the_limit_of_large_stiffness():
    """alpha = 4: EA = GA = 1e4, 1e6, 1e8 approach EA = GA = inf in proportion to 1/EA; the strains
    are then exactly zero.
    """
    load = tb.TipLoad(force=(0.5, 1.0, 4.0), moment=(0.1, 0, 0))
    exact = tb.equilibrium(cantilever(8, load))
    soft = [tb.equilibrium(cantilever(8, load, of=section(k, k))) for k in (1e4, 1e6, 1e8)]
    gaps = [(state.tip.position - exact.tip.position).norm() for state in soft]
    assert_close(gaps[0] / gaps[1], torch.tensor(100.0), rtol=1e-2, atol=0)
    assert_close(gaps[1] / gaps[2], torch.tensor(100.0), rtol=1e-2, atol=0)
    lengths = exact.position.diff(dim=-2).norm(dim=-1)
    assert_close(lengths, torch.full((8,), 1 / 8), rtol=1e-12, atol=0)


def test_everything_rigid_does_not_move():
    """Six infinite stiffnesses: the undeformed beam, and the reaction that holds the load."""
    rigid = tb.Section.from_stiffness(EA=INF, GA=INF, GJ=INF, EI=INF, mass=1.0)
    state = tb.equilibrium(cantilever(3, tb.TipLoad(force=(1.0, 2, 3)), of=rigid))
    assert_close(state.tip.position, torch.tensor([1.0, 0, 0]), rtol=0, atol=1e-14)
    assert_close(state.root.force, torch.tensor([-1.0, -2, -3]))
    assert_close(state.root.moment, torch.tensor([0.0, 3, -2]))


def test_a_sample_without_equilibrium_says_so():
    """An end moment of 25 rad an element (pi is the limit): status 1, its neighbours solved,
    RuntimeError where asked.
    """
    scene = cantilever(8, tb.TipLoad(moment=along_z(torch.tensor([1.0, 200.0, 2.0]))))
    state = tb.equilibrium(scene, throw=False)
    assert state.status.tolist() == [0, 1, 0]
    assert torch.isfinite(state.position).all()
    alone = tb.equilibrium(cantilever(8, tb.TipLoad(moment=(0, 0, 2.0))))
    # rounding times a condition of 8^4; 9e-13 seen
    assert_close(state.position[2], alone.position, rtol=0, atol=1e-11)
    with pytest.raises(RuntimeError, match=r"found no equilibrium of sample 1 \(1 of"):
        tb.equilibrium(scene)


def test_unstable_equilibrium_is_told():
    """Column under a dead axial load with an imperfection of 1e-6: stable below Euler's load,
    pi^2/4 = 2.467, and on the straight branch above it, where the solver's way up leads, unstable.
    """

    def column(P):
        P = torch.as_tensor(P)
        section = tb.Section.from_stiffness(1e4, 5e3, 1.0, 1.0, 1.0)
        return tb.Scene(
            tb.Beam.straight(1.0, 16, section),
            [tb.TipLoad(force=torch.stack((-P, 0 * P + 1e-6, 0 * P), -1))],
        )

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tb.equilibrium(column(2.45))
    with pytest.warns(RuntimeWarning, match="the beam .* unstable"):
        tb.equilibrium(column(2.5))
    with pytest.warns(RuntimeWarning, match=r"sample 1 \(2 of 3\) is in unstable equilibrium"):
        tb.equilibrium(column([1.0, 5.0, 3.0]))
