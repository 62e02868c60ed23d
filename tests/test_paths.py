"""path: limit points, snap-through, bifurcation and the branches behind it; what equilibrium makes of them."""

import math
import warnings

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.paths import BRANCH_POINT, REGULAR

INF = math.inf
# Timoshenko and Gere, Theory of Elastic Stability (1961), table 2.4: angle of the tip, P/Pcr, x/L, y/L
ELASTICA = torch.tensor([[40, 1.063, 0.881, 0.422], [80, 1.293, 0.560, 0.719], [120, 1.884, 0.123, 0.803],
                         [160, 4.029, -0.340, 0.625]])


def column(P, lean=0.0, N=16, EI=(1.0, 1.0), **options):
    """Inextensible, under a dead axial load and a share `lean` of it across."""
    P = torch.as_tensor(P)
    section = tb.Section.from_stiffness(EA=INF, GA=INF, GJ=1.0, EI=EI, mass=1.0, inertia=0.01)
    load = tb.TipLoad(force=torch.stack((-P, lean * P, 0 * P), -1))
    return tb.Scene(tb.Beam.straight(1.0, N, section), [load], **options)


def test_a_path_without_events_ends_where_equilibrium_does():
    """A batch of transverse loads, all loads scaled: the last state is the equilibrium's, to its tolerance."""
    section = tb.Section.from_stiffness(EA=INF, GA=INF, GJ=1.0, EI=1.0, mass=1.0, inertia=0.01)
    P = torch.tensor([1.0, 10.0])
    scene = tb.Scene(tb.Beam.straight(1.0, 8, section), [tb.TipLoad(force=torch.stack((0 * P, 0 * P, P), -1))])
    path, want = tb.path(scene, step=0.3), tb.equilibrium(scene)
    assert path.reached.all() and path.stable.all() and (path.kind == REGULAR).all() and (path.state.status == 0).all()
    assert_close(path.factor[-1], torch.ones(2), rtol=0, atol=1e-12)
    assert_close(path.state.tip.position[-1], want.tip.position, rtol=0, atol=1e-7)
    assert_close(path.state.root.moment[-1], want.root.moment, rtol=1e-6, atol=1e-6)
    assert (path.valid.sum(0)[0] < path.valid.sum(0)[1]) and (path.factor.diff(dim=0) >= 0).all()


def test_a_named_input_alone_is_scaled():
    """Gravity stays, the input rises: at factor 0 the beam is bent already."""
    section = tb.Section.from_stiffness(EA=INF, GA=INF, GJ=1.0, EI=1.0, mass=1.0, inertia=0.01)
    scene = tb.Scene(tb.Beam.straight(1.0, 8, section), [tb.Gravity((0, 0, -1.0)), tb.TipLoad(force=tb.Input("u", 3))])
    bent = tb.equilibrium(scene, u=torch.zeros(3))
    u = torch.tensor([0.0, 1.0, 0])
    path, want = tb.path(scene, load="u", initial=bent, u=u), tb.equilibrium(scene, u=u).tip.position
    assert_close(path.state.tip.position[0], bent.tip.position, rtol=0, atol=1e-12)
    assert_close(path.state.tip.position[-1], want, rtol=0, atol=1e-6)  # 1e-8 of the load, times 12


def test_the_straight_column_is_left_where_it_buckles():
    """Perfect column to twice Euler's load: without `branch` the straight path, unstable from pi^2/4; with it the buckled one,
    stable. The jump is between the two path points around the critical load.
    """
    straight, buckled = (tb.path(column(5.0, EI=(3.0, 1.0)), branch=branch) for branch in (False, True))
    event = int((straight.kind == BRANCH_POINT).nonzero()[0, 0])
    assert straight.factor[event - 1] * 5 < math.pi**2 / 4 < straight.factor[event] * 5
    assert (straight.state.position[..., 1:].abs() < 1e-9).all() and straight.negative[-1] == 1
    assert buckled.reached and buckled.negative[-1] == 0 and buckled.state.tip.position[-1, 1].abs() > 0.5


def test_elastica_behind_the_bifurcation():
    """Timoshenko and Gere's table of the buckled column, printed to 1e-3: P/Pcr from 1.063 to 4.029 as one batch of imperfect
    columns (1e-6), each to the side to which it leans. N = 32: its Pcr is 4e-4 higher, which near the bifurcation is 4e-3 in
    y (dy/dP = 6 there): measured 2.2e-3.
    """
    _, ratio, x, y = ELASTICA.unbind(-1)
    lean = torch.tensor([1e-6, 1e-6, -1e-6, 1e-6])
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        tip = tb.equilibrium(column(ratio * math.pi**2 / 4, lean, N=32), branch="stable").tip.position
    assert_close(tip[:, 0], x, rtol=0, atol=3e-3)
    assert_close(tip[:, 1], y * lean.sign(), rtol=0, atol=3e-3)


def test_gradient_on_the_stable_branch():
    """d(tip)/d(load) there, against central differences (1e-4: 1e-6); of its neighbour, below Euler's load, too."""
    def tip(P):
        return tb.equilibrium(column(P, 1e-6, N=8, EI=(3.0, 1.0)), branch="stable", tolerance=1e-11).tip.position[:, 0]

    P = torch.tensor([5.0, 1.0], requires_grad=True)
    (slope,) = torch.autograd.grad(tip(P).sum(), P)
    wanted = (tip(P.detach() + 1e-4) - tip(P.detach() - 1e-4)) / 2e-4
    assert_close(slope, wanted, rtol=1e-5, atol=1e-9)


def test_derivatives_at_a_bifurcation_are_doubtful():
    """At the critical load itself the tangent is singular: a sentence says so, about that sample alone."""
    at = tb.critical_load(lambda P: column(P, N=4), 5.0).factor
    P = torch.stack((at, torch.ones(()))).requires_grad_()
    with pytest.warns(RuntimeWarning, match=r"sample 0 \(1 of 2\) is at a point of bifurcation"):
        tb.equilibrium(column(P, N=4))


def test_refusals():
    with pytest.raises(ValueError, match="control without target"):
        tb.path(column(1.0), control=lambda s: s.tip.position[..., 1])
    with pytest.raises(ValueError, match="load = 'v' was given; the scene's inputs are none"):
        tb.path(column(1.0), load="v")
    with pytest.raises(ValueError, match="a range with 0 in it"):
        tb.path(column(1.0), -1.0)
    with pytest.raises(ValueError, match="branch = 'second' was given"):
        tb.equilibrium(column(1.0), branch="second")
