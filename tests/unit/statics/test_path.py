"""path: limit points, snap-through, bifurcation and the branches behind it; what equilibrium makes
of them.
"""

import math
import warnings
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam import extend
from torchbeam.statics.continuation import BRANCH_POINT, LIMIT_POINT, REGULAR

pytestmark = pytest.mark.steps
INF = math.inf


# Timoshenko and Gere, Theory of Elastic Stability (1961), table 2.4: angle of the tip, P/Pcr, x/L,
# y/L
def column(P, lean=0.0, N=16, EI=(1.0, 1.0), **options):
    """Inextensible, under a dead axial load and a share `lean` of it across."""
    P = torch.as_tensor(P)
    section = tb.Section.from_stiffness(EA=INF, GA=INF, GJ=1.0, EI=EI, mass=1.0, inertia=0.01)
    load = tb.TipLoad(force=torch.stack((-P, lean * P, 0 * P), -1))
    return tb.Scene(tb.Beam.straight(1.0, N, section), [load], **options)


def test_a_path_without_events_ends_where_equilibrium_does():
    """A batch of transverse loads, all loads scaled: the last state is the equilibrium's, to its
    tolerance.
    """
    section = tb.Section.from_stiffness(EA=INF, GA=INF, GJ=1.0, EI=1.0, mass=1.0, inertia=0.01)
    P = torch.tensor([1.0, 10.0])
    scene = tb.Scene(
        tb.Beam.straight(1.0, 8, section), [tb.TipLoad(force=torch.stack((0 * P, 0 * P, P), -1))]
    )
    path, want = tb.path(scene, step=0.3), tb.equilibrium(scene)
    assert (
        path.reached.all()
        and path.stable.all()
        and (path.kind == REGULAR).all()
        and (path.state.status == 0).all()
    )
    assert_close(path.factor[-1], torch.ones(2), rtol=0, atol=1e-12)
    assert_close(path.state.tip.position[-1], want.tip.position, rtol=0, atol=1e-7)
    assert_close(path.state.root.moment[-1], want.root.moment, rtol=1e-6, atol=1e-6)
    assert (path.valid.sum(0)[0] < path.valid.sum(0)[1]) and (path.factor.diff(dim=0) >= 0).all()


def test_long_steps_stay_on_the_path_that_an_imperfection_opens():
    """Past 2.47 N the straight column has three equilibria; those that lean a little come to that
    behind the turn from no load on: by steps of 0.3, which reach from before the turn over to the
    unstable one on the other side, as by short ones.
    """
    of = column(torch.full((2,), 4.0), torch.tensor([1e-2, 1e-3]), N=4, plane="xy")
    short, long = (tb.path(of, step=step) for step in (0.1, 0.3))
    for path in (short, long):
        assert path.reached.all() and path.stable.all() and (path.kind == REGULAR).all()
    assert_close(long.state.tip.position[-1], short.state.tip.position[-1], rtol=0, atol=1e-7)


def test_a_named_input_alone_is_scaled():
    """Gravity stays, the input rises: at factor 0 the beam is bent already."""
    section = tb.Section.from_stiffness(EA=INF, GA=INF, GJ=1.0, EI=1.0, mass=1.0, inertia=0.01)
    scene = tb.Scene(
        tb.Beam.straight(1.0, 8, section),
        [tb.Gravity((0, 0, -1.0)), tb.TipLoad(force=tb.Input("u", 3))],
    )
    bent = tb.equilibrium(scene, inputs={"u": torch.zeros(3)})
    u = torch.tensor([0.0, 1.0, 0])
    path = tb.path(scene, load="u", initial=bent, inputs={"u": u})
    assert_close(path.state.reaction[0], bent.reaction, rtol=0, atol=1e-7)  # of 1 N
    want = tb.equilibrium(scene, inputs={"u": u}).tip.position
    assert_close(path.state.tip.position[0], bent.tip.position, rtol=0, atol=1e-12)
    assert_close(path.state.tip.position[-1], want, rtol=0, atol=1e-6)  # 1e-8 of the load, times 12


@dataclass(frozen=True)
class Prop(extend.Interaction):
    """A spring between two nodes against what they move across, z."""

    stiffness: extend.Value = extend.leaf(0)  # N/m

    depends = frozenset({extend.POSITION})
    conservative = resists = True

    def wrench(self, point, t, inputs):
        across = point.position.new_tensor([0.0, 0.0, 1.0])
        pull = self.stiffness[..., None, None] * across * point.position.diff(dim=-2)
        return torch.cat((pull, -pull), -2), None


# what resists, the stiffness N/m of the tip with it, and its force there without a load, N
K, H = 3.0, 1e-4
RESISTING = {
    "spring": (tb.Spring(-1, K), 3 + K, 0.0),
    "taut": (tb.Spring(-1, K, to=(1.0, 0.0, H)), 3 + K, K * H),
    "elastic clamp": (tb.RootSpring((6.0, 2.0)), 1 / (1 / 3 + 1 / 6 + 1 / 2), 0.0),
    "interaction": (Prop((-1, 0), K), 3 + K, 0.0),
}


@pytest.mark.parametrize("engine", ("eager", "compiled"))
@pytest.mark.parametrize("name", RESISTING)
def test_what_resists_is_no_load(name, engine):
    """A cantilever's tip at w = (f P + F)/k, with the stiffness k of 3 EI/L^3 beside a spring, or
    behind an elastic clamp, and a spring's force F, whatever the factor f. EI = L = 1; of eight
    elements with linked interpolation and of shear (GA = 1e6) 1e-3, of rotations (3e-4) nothing.
    """
    section = tb.Section.from_stiffness(EA=1e6, GA=1e6, GJ=1.0, EI=1.0, mass=1.0)
    (effect, stiffness, pull), P = RESISTING[name], torch.tensor([0.0, 0.0, 1e-3])
    beam = tb.Beam.straight(1.0, 8, section).linked()
    scene = tb.Scene(beam, [tb.TipLoad(force=P), effect])
    path = tb.path(scene, step=0.3, engine=engine)
    f = path.factor
    assert path.reached and f[0] == 0 and len(f) > 3 and f[-1] == 1
    assert_close(path.state.tip.position[:, 2], (f * P[2] + pull) / stiffness, rtol=2e-3, atol=1e-9)


@pytest.mark.parametrize("node, engine", [(-1, "eager"), (-1, "compiled"), (None, "eager")])
def test_what_is_touched_is_no_load(node, engine):
    """A cantilever pressed onto a floor 0.1 m below by 1 N, by its tip or along it (which native
    code leaves to torch): each point is the equilibrium under that share of the load, to Newton's
    tolerance (1e-8 of the loads, beside the softest stiffness, 3 N/m).
    """
    floor = tb.Plane((0, 0, -0.1), (0, 0, 1.0))
    floor = tb.Contact(floor, node=node, thickness=0.05, force=20.0)
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=1.0)
    beam = tb.Beam.straight(1.0, 2, section)

    def scene(P):
        force = P[..., None] * torch.tensor([0.0, 0, -1.0])
        return tb.Scene(beam, [tb.TipLoad(force=force), floor], plane="xz")

    path = tb.path(scene(torch.tensor(1.0)), step=0.3, engine=engine)
    each = tb.equilibrium(scene(path.factor))
    assert path.reached and (path.state.tip.position[-1, 2] < -0.055)
    assert_close(path.state.position, each.position, rtol=0, atol=1e-7)


def test_a_column_on_an_elastic_clamp_buckles_where_it_does():
    """Beside a clamp that yields by k about an axis, b tan b = k L/EI, P = EI (b/L)^2 (Timoshenko
    and Gere 1961, section 2.3): 0.7402 N with EI = L = k = 1. A path marks the segment with it,
    `critical_load` finds it: of 16 elements 2e-3.
    """
    want, full = 0.8603336**2, 1.48
    spring = tb.RootSpring((1e7, 1e7, 1e7, 1e3, 1.0, 1e3))
    beam = column(full).beam

    def scene(P):
        force = P[..., None] * torch.tensor([-full, 0.0, 0.0])
        return tb.Scene(beam, [tb.TipLoad(force=force), spring], plane="xz")

    path = tb.path(scene(torch.tensor(1.0)), 0.6, step=0.05)
    (at,) = (path.kind == BRANCH_POINT).nonzero()[:, 0]
    low, high = full * path.factor[at - 1 : at + 1]
    assert path.stable[:at].all() and not path.stable[at:].any()
    assert low < want < high and high - low < 0.06
    critical = tb.critical_load(scene, 1.0)
    assert_close(full * critical.factor.double(), torch.tensor(want), rtol=2e-3, atol=0)


def test_supports_and_eigenstrain_go_with_the_factor():
    """A displaced end, an actuated beam under a load, and both beside a taut spring that does not
    go with them: each point is the equilibrium of that share of all of it, to Newton's tolerance
    (1e-8 of the loads, 6 N, beside the softest stiffness, 1 N m^2).
    """
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2)
    beam = tb.Beam.straight(1.0, 4, section)

    def displaced(share, *effects):
        supports = [tb.Support(0), tb.Support(-1, displacement=(0.01 * share, 0.0, 0.1 * share))]
        return tb.Scene(beam, [tb.LineLoad(force=(0, 0, share)), *effects], supports=supports)

    def actuated(share):
        return tb.Scene(
            beam,
            [tb.Actuation(curvature=(0, 3.0 * share, 0)), tb.TipLoad(force=(0, 0, -5.0 * share))],
        )

    def taut(share):
        bent = tb.Actuation(curvature=(0, 3.0 * share, 0))
        return displaced(share, bent, tb.Spring(2, 20.0, to=(0.5, 0.0, 0.5)))

    for scene in (displaced, actuated, taut):
        path = tb.path(scene(1.0), step=0.2)
        assert path.reached
        for factor, nodes in zip(path.factor.tolist(), path.state.nodes, strict=True):
            assert_close(nodes, tb.equilibrium(scene(factor)).nodes, rtol=0, atol=1e-7)


def test_many_samples_take_the_path_that_each_takes_alone():
    """80 loads, most of them small: Newton's method goes on with the few that have not converged,
    by their own problem.
    """
    section = tb.Section.from_stiffness(EA=INF, GA=INF, GJ=1.0, EI=1.0, mass=1.0, inertia=0.01)
    P = torch.cat((torch.linspace(0.01, 0.05, 72), torch.linspace(5.0, 20.0, 8)))

    def path(P, force="force"):
        load = tb.TipLoad(
            force=tb.Input("u", 3) if force == "u" else torch.stack((0 * P, 0 * P, P), -1)
        )
        return tb.path(
            tb.Scene(tb.Beam.straight(1.0, 2, section), [load]),
            step=0.5,
            **(
                dict(load="u", inputs={"u": torch.stack((0 * P, 0 * P, P), -1)})
                if force == "u"
                else {}
            ),
        )

    for force in ("force", "u"):
        all_, one = path(P, force), path(P[-1], force)
        assert all_.reached.all()
        assert_close(
            all_.state.tip.position[-1, -1], one.state.tip.position[-1], rtol=0, atol=1e-10
        )


def test_the_straight_column_is_left_where_it_buckles():
    """Perfect column to twice Euler's load: without `branch` the straight path, unstable from
    pi^2/4; with it the buckled one, stable. The jump is between the two path points around the
    critical load.
    """
    straight, buckled = (
        tb.path(column(5.0, EI=(3.0, 1.0)), branch=branch) for branch in (False, True)
    )
    event = int((straight.kind == BRANCH_POINT).nonzero()[0, 0])
    assert straight.factor[event - 1] * 5 < math.pi**2 / 4 < straight.factor[event] * 5
    assert (straight.state.position[..., 1:].abs() < 1e-9).all() and straight.negative[-1] == 1
    assert (
        buckled.reached
        and buckled.negative[-1] == 0
        and buckled.state.tip.position[-1, 1].abs() > 0.5
    )


def pushed(N):
    """A column that has buckled to y > 0 under 1.3 times Euler's load (0.7 L), and an input that
    pushes it back.
    """
    section = tb.Section.from_stiffness(
        EA=INF, GA=INF, GJ=1.0, EI=(3.0, 1.0), mass=1.0, inertia=0.01
    )
    loads = [tb.TipLoad(force=(-1.3 * math.pi**2 / 4, 0, 0)), tb.TipLoad(force=tb.Input("u", 3))]
    scene = tb.Scene(tb.Beam.straight(1.0, N, section), loads)
    return scene, tb.equilibrium(
        scene, branch="stable", inputs={"u": torch.tensor([0.0, 1e-6, 0.0])}
    )


def snapping_force():
    """The largest F for which theta'' = F cos(theta) - P sin(theta), theta(0) = theta'(1) = 0, has
    a solution: F over the tip's angle, by shooting from the tip (Runge and Kutta, 100 steps: 1e-9)
    and bisection.
    """
    P, n = 1.3 * np.pi**2 / 4, 100
    angle = np.linspace(0.5, 1.6, 45)

    def at_root(F):
        x, v, h = angle.copy(), np.zeros_like(angle), 1 / n
        slope = lambda x: F * np.cos(x) - P * np.sin(x)  # noqa: E731
        for _ in range(n):
            k1, l1 = v, slope(x)
            k2, l2 = v + h / 2 * l1, slope(x + h / 2 * k1)
            k3, l3 = v + h / 2 * l2, slope(x + h / 2 * k2)
            k4, l4 = v + h * l3, slope(x + h * k3)
            x, v = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), v + h / 6 * (l1 + 2 * l2 + 2 * l3 + l4)
        return x

    # at the root the angle rises with F
    low, high = np.full_like(angle, -2.0), np.full_like(angle, 2.0)
    for _ in range(45):
        middle = (low + high) / 2
        over = at_root(middle) > 0
        low, high = np.where(over, low, middle), np.where(over, middle, high)
    k = middle.argmax()
    return np.polyval(
        fit := np.polyfit(angle[k - 2 : k + 3], middle[k - 2 : k + 3], 2), -fit[1] / (2 * fit[0])
    )


def test_snap_through():
    """The buckled column pushed back: it gives way at a limit point, an unstable part leads through
    the straight column to a second one, the mirror image of the first (dead loads, a symmetric
    beam), and it ends on the other side, stable. The force at the limit, from a parabola through
    the three points around it (1e-3), is the elastica's: 4.3 % below at N = 8, 1.1 % at 16 (it goes
    like (P - Pcr)^1.5, and Pcr is the mesh's), extrapolated 1e-3. The finer mesh goes just past the
    first limit.
    """
    wanted, found = snapping_force(), []
    for N, steps in ((8, 100), (16, 16)):
        scene, bent = pushed(N)
        path = tb.path(
            scene, 1.0, lowest=-1.0, load="u", initial=bent,
            inputs={"u": torch.tensor([0.0, -1.0, 0])}, step=0.08, steps=steps,
        )  # fmt: skip
        y, F = path.state.tip.position[:, 1], path.factor
        first, *second = (path.kind == LIMIT_POINT).nonzero()[:, 0].tolist()
        peaks = [_peak(y, F, k) for k in (first, *second)]
        found.append(peaks[0].item())
        assert y[0] > 0.6 and path.stable[:first].all() and (path.kind == BRANCH_POINT).sum() == 0
        if N == 8:
            assert path.reached and y[-1] < -0.6
            assert (path.negative[first : second[0]] == 1).all() and path.stable[second[0] :].all()
            assert_close(peaks[0], -peaks[1], rtol=2e-3, atol=0)  # of the parabolas
    assert abs((4 * found[1] - found[0]) / 3 / wanted - 1) < 2e-3


def test_limit_points_under_loads_that_follow():
    """A follower force and a dead moment: the factor turns back where the determinant of the
    tangent, which is not symmetric, changes its sign, and nowhere else is there an event; pivots of
    its symmetric part change theirs elsewhere, and more often.
    """
    section = tb.Section.from_stiffness(EA=1e4, GA=1e3, GJ=1.0, EI=1.0, mass=1.0)
    loads = [
        tb.TipLoad(force=(-4.53, -9.23, -20.02), follower=True),
        tb.TipLoad(moment=(3.5, -10.69, -0.13)),
    ]
    path = tb.path(tb.Scene(tb.Beam.straight(1.0, 4, section), loads), step=0.1)
    back = path.factor.diff().sign().diff().nonzero()[:, 0] + 1  # the last before it turns
    events = path.kind.nonzero()[:, 0]
    assert path.reached and len(events) == len(back) == 2
    assert ((events - back) * (back + 1 - events) >= 0).all()
    assert (path.kind[events] == LIMIT_POINT).all()
    assert (path.negative.diff() != 0).sum() > 2


def _peak(y, F, event):
    k = max(range(event - 1, event + 2), key=lambda k: abs(F[k]))
    c = torch.linalg.solve(
        torch.stack((torch.ones(3), y[k - 1 : k + 2], y[k - 1 : k + 2] ** 2), -1), F[k - 1 : k + 2]
    )
    return c[0] - c[1] ** 2 / (4 * c[2])


def test_displacement_control_passes_the_same_points():
    """The same path by equal steps of the tip's y, as a batch of two targets: each as alone, and on
    the arc-length curve.
    """
    scene, bent = pushed(4)
    u, control = torch.tensor([0.0, -1.0, 0]), lambda s: s.tip.position[..., 1]
    both = tb.path(
        scene, load="u", initial=bent, control=control, target=torch.tensor([-0.6, 0.2]), step=0.15,
        inputs={"u": u},
    )  # fmt: skip
    alone = tb.path(
        scene, load="u", initial=bent, control=control, target=0.2, step=0.15, inputs={"u": u}
    )
    assert both.reached.all() and both.factor.shape[1:] == (2,)
    assert_close(both.state.tip.position[-1, :, 1], torch.tensor([-0.6, 0.2]), rtol=0, atol=1e-8)
    assert_close(both.factor[:, 1], alone.factor, rtol=0, atol=1e-9)
    arc = tb.path(scene, 0.5, lowest=-0.5, load="u", initial=bent, step=0.06, inputs={"u": u})
    on_arc = np.interp(-both.state.tip.position[:, 0, 1], -arc.state.tip.position[:, 1], arc.factor)
    # straight lines between steps of 0.06
    assert_close(both.factor[:, 0], torch.tensor(on_arc), rtol=0, atol=5e-3)


def test_gradient_on_the_stable_branch():
    """d(tip)/d(load) there, against central differences (1e-4: 1e-6); of its neighbour, below
    Euler's load, too, where it is nearly zero: there the difference of two places that Newton
    leaves 2e-13 uncertain counts 1e-9.
    """

    def tip(P):
        return tb.equilibrium(
            column(P, 1e-6, N=4, EI=(3.0, 1.0)), branch="stable", tolerance=1e-11
        ).tip.position[:, 0]

    P = torch.tensor([5.0, 1.0], requires_grad=True)
    (slope,) = torch.autograd.grad(tip(P).sum(), P)
    wanted = (tip(P.detach() + 1e-4) - tip(P.detach() - 1e-4)) / 2e-4
    assert_close(slope, wanted, rtol=1e-5, atol=1e-8)


def test_derivatives_at_a_bifurcation_are_doubtful():
    """At the critical load itself the tangent is singular: a sentence says so, about that sample
    alone.
    """
    at = tb.critical_load(lambda P: column(P, N=4), 5.0).factor
    P = torch.stack((at, torch.ones(()))).requires_grad_()
    with pytest.warns(RuntimeWarning, match=r"sample 0 \(1 of 2\) is at a point of bifurcation"):
        tb.equilibrium(column(P, N=4))


@pytest.mark.parametrize("force", [(-4.0, 0.0), (-4.0, 1e-3), (-40.0, 0.0)])
def test_derivatives_past_buckling(force):
    """Of a column in a plane on its straight branch past Euler's load, perfect or not, on which
    nothing is soft: by the load, as by differences.
    """
    P = torch.tensor([force[0], 0.0, force[1]], dtype=torch.float64)

    def tip(load):
        section = tb.Section.from_stiffness(1e4, 5e3, 1.0, 1.0, 1.0)
        beam = tb.Beam.straight(1.0, 6, section)
        return tb.equilibrium(tb.Scene(beam, [tb.TipLoad(force=load)], plane="xz")).tip.position

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*unstable", RuntimeWarning)
        slopes = torch.autograd.functional.jacobian(tip, P)
        steps = 1e-4 * torch.eye(3, dtype=P.dtype)[[0, 2]]
        wanted = torch.stack([(tip(P + d) - tip(P - d)) / 2e-4 for d in steps], -1)
    assert_close(slopes[:, [0, 2]], wanted, rtol=1e-4, atol=1e-7)


def test_what_turns_freely_is_at_no_limit_point():
    """A round column past Euler's load, bent in some plane: the load has no share in the turn of
    that plane, whatever rounding leaves of its stiffness, and derivatives by it are there.
    """
    section = tb.Section.from_stiffness(EA=1e8, GA=1e8, GJ=0.8, EI=1.0, mass=0.2)
    beam = tb.Beam.straight(1.0, 3, section)
    P = torch.tensor([3.2, 3.2 - 1e-4, 3.2 + 1e-4], dtype=torch.float64).requires_grad_()

    load = tb.TipLoad(force=torch.stack((-P, 0 * P, 0 * P), -1))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*bifurcation", RuntimeWarning)
        tip = tb.equilibrium(tb.Scene(beam, [load]), relax=True).tip.position[:, 0]
    (slope,) = torch.autograd.grad(tip.sum(), P)
    wanted = (tip[2] - tip[1]).detach() / 2e-4
    assert_close(slope[0], wanted, rtol=1e-3, atol=0)


def test_refusals():
    with pytest.raises(ValueError, match="control without target"):
        tb.path(column(1.0), control=lambda s: s.tip.position[..., 1])
    with pytest.raises(ValueError, match="load = 'v' was given; the scene's inputs are none"):
        tb.path(column(1.0), load="v")
    with pytest.raises(ValueError, match="a range with 0 in it"):
        tb.path(column(1.0), -1.0)
    with pytest.raises(ValueError, match="branch = 'second' was given"):
        tb.equilibrium(column(1.0), branch="second")


def test_a_control_is_one_number_of_each_sample():
    push = tb.Scene(
        tb.Beam.straight(
            1.0, 2, tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2)
        ),
        [tb.TipLoad(force=(0.0, 0.0, 1.0))],
    )
    with pytest.raises(ValueError, match=r"a control that returns \(3,\) was given"):
        tb.path(push, control=lambda state: state.tip.position, target=1.0)


@pytest.mark.parametrize("n", [1, 3, 8])
def test_what_loads_alone_hold_has_no_path_from_none(n):
    """A pinned beam under gravity hangs; with none of it nothing holds it, on any mesh."""
    section = tb.Section.circle(0.01, 1e7, 0.3, 1e3)
    scene = tb.Scene(
        tb.Beam.straight(1.0, n, section, direction=(0, 0, -1.0), up=(1.0, 0, 0)),
        [tb.Gravity((0, 0, -9.81))],
        supports=[tb.Support(0, rotation="")],
    )
    with pytest.warns(RuntimeWarning, match=r"no beginning, for nothing holds the rotation about "):
        way = tb.path(scene)
    assert not way.reached and len(way.factor) == 1 and way.state.status[-1] != 0


def test_a_path_beside_loads_that_stay_begins_at_their_equilibrium():
    """A cantilever that sags by a fifth of its length under its weight: the first point is that
    equilibrium, the last the one under both. Where load steps do not come to one (a shallow arch
    pressed beyond its limit), no point of the path is valid, and a sentence says so.
    """
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2)
    push = tb.PointLoad(4, force=tb.Input("P", 3))
    beam = tb.Beam.straight(1.0, 8, section)
    scene = tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), push])
    inputs = {"P": torch.tensor([0.0, 0, 0.5])}
    way = tb.path(scene, 1.0, load="P", inputs=inputs, step=0.3)
    none = {"P": torch.zeros(3)}
    for k, known in ((0, none), (-1, inputs)):
        state = tb.equilibrium(scene, inputs=known)
        assert_close(way.state.position[k], state.position, rtol=0, atol=1e-9)
    assert way.reached and way.valid.all() and way.stable.all()
    stays = tb.Scene(beam, [tb.TipLoad(force=(0, 0, -1e9)), push])
    with pytest.warns(RuntimeWarning, match="do not come to an equilibrium of what stays"):
        way = tb.path(stays, 1.0, load="P", inputs=inputs, step=0.3)
    assert not way.valid.any() and way.state.status[-1] != 0
