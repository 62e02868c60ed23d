"""critical_load: buckling and flutter loads against closed forms, over batches, with gradients.

Elements are of second order: the values of two meshes, N and 2N, extrapolated as (4 x_2N - x_N)/3,
are held to 2e-4 (the next term, (kh)^4, measured below 1e-4 at N = 8 and 16; for flutter 2e-3,
whose second mode is coarser). A column under its own weight and one with slight damping are rows of
the verification table.
"""

import math
import warnings

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.equations import load_steps
from torchbeam.linear import load_path
from torchbeam.linear.system_matrices import in_basis, of_chain, of_nodes
from torchbeam.math.block_tridiagonal import BlockChain
from torchbeam.math.quadratic_eigen import slow_first, slow_values
from torchbeam.nodal.discretise import discretise
from torchbeam.topology.framework_matrix import FrameworkMatrix

INF = math.inf
NEXT_TERM = 2e-4


def along_x(P):
    return torch.stack((P, 0 * P, 0 * P), -1)


def planar(N, *effects, EI=1.0):
    """A cantilever that bends in the x-z plane alone, inextensible, unshearable, no rotary
    inertia.
    """
    section = tb.Section.from_stiffness(EA=INF, GA=INF, GJ=INF, EI=(EI, INF), mass=1.0, inertia=0.0)
    return tb.Scene(tb.Beam.straight(1.0, N, section), effects)


def extrapolated(coarse, fine):
    return (4 * fine - coarse) / 3


def test_euler(reference):
    """Dead axial load: (pi/2)^2 EI/L^2, by a batch of EI; d(factor)/d(EI) is factor/EI, backward
    and forward. Divergence, though rounding makes pairs of other eigenvalues complex where K is
    next to singular (as it does here with 9 points).
    """
    want = reference("stability_limits")["values"][0]["value"]
    EI = torch.tensor([1.0, 3.0], requires_grad=True)

    def of(EI, N=8):
        return tb.critical_load(
            lambda P: planar(N, tb.TipLoad(force=along_x(-P)), EI=EI), 12.0, points=9
        )

    found = of(EI)
    assert found.divergence.all() and (found.frequency == 0).all()
    limit = extrapolated(found.factor.detach(), of(EI.detach(), 16).factor)
    assert_close(limit, want * EI.detach(), rtol=NEXT_TERM, atol=0)
    (slope,) = torch.autograd.grad(found.factor.sum(), EI)
    # rigid strains are 1e-7 flexible, curvature 1
    assert_close(slope, (found.factor / EI).detach(), rtol=1e-4, atol=0)
    forward = torch.func.jvp(lambda EI: of(EI, 4).factor, (EI.detach(),), (torch.ones(2),))[1]
    # four elements: 2.6 % and 0.6 % from the elastica's
    assert_close(forward, slope, rtol=0.05, atol=0)


def test_beck(reference):
    """Tangential load: flutter at 20.0510 EI/L^2 with 11.0156 rad/s (reference 1e-6). Batch of EI;
    the gradient is the factor over EI, through the point where two eigenvalues meet.
    """
    case = reference("stability_limits")["values"][1]
    EI = torch.tensor([1.0, 2.0], requires_grad=True)

    def of(N, EI):
        def follower(P):
            return planar(N, tb.TipLoad(force=along_x(-P), follower=True), EI=EI)

        return tb.critical_load(follower, 60.0, points=13)

    found, fine = of(8, EI), of(16, EI.detach())
    assert found.flutter.all()
    factor, frequency = (
        extrapolated(getattr(found, name).detach(), getattr(fine, name))
        for name in ("factor", "frequency")
    )
    assert_close(factor, case["P_cr_L2_over_EI"] * EI.detach(), rtol=2e-3, atol=0)
    assert_close(frequency, case["omega_flutter"] * EI.detach().sqrt(), rtol=2e-3, atol=0)
    (slope,) = torch.autograd.grad(found.factor.sum(), EI)
    assert_close(slope, (found.factor / EI).detach(), rtol=1e-3, atol=0)


def test_beck_in_space():
    """A round column flutters in all planes at once: eigenvalues come in equal pairs, and the
    gradient is still there (the factor over EI, less the 1 % that shear, rotary inertia and length
    do not scale with it).
    """
    EI = torch.tensor(1.0, requires_grad=True)
    section = tb.Section.from_stiffness(EA=4e4, GA=1e4, GJ=0.8, EI=EI, mass=1.0, inertia=1e-3)
    column = tb.Beam.straight(1.0, 8, section)
    found = tb.critical_load(
        lambda P: tb.Scene(column, [tb.TipLoad(force=along_x(-P), follower=True)]), 60.0, points=13
    )
    alone = tb.Section.from_stiffness(EA=4e4, GA=1e4, GJ=INF, EI=(1.0, INF), mass=1.0, inertia=1e-3)
    plane = tb.Beam.straight(1.0, 8, alone)
    same = tb.critical_load(
        lambda P: tb.Scene(plane, [tb.TipLoad(force=along_x(-P), follower=True)]), 60.0, points=13
    )
    assert_close(found.factor.detach(), same.factor, rtol=1e-5, atol=0)
    (slope,) = torch.autograd.grad(found.factor, EI)
    assert_close(slope, found.factor.detach(), rtol=1e-2, atol=0)


def test_a_follower_load_that_buckles_does_not_flutter():
    """A load that follows the tip by a fifth: cos(k) = 0.2/(0.2 - 1), P = k^2 EI/L^2 (Kordas and
    Zyczkowski 1963), a mesh of 8 is 1 % off. Next to that point, where EA = 1e9 EI/L^2, rounding of
    the stiffness makes no pairs of the other eigenvalues.
    """
    column = tb.Beam.straight(
        1.0, 8, tb.Section.from_stiffness(EA=1e9, GA=1e9, GJ=0.8, EI=1.0, mass=1.0, inertia=1e-4)
    )
    found = tb.critical_load(
        lambda P: tb.Scene(
            column,
            [
                tb.TipLoad(force=along_x(-0.8 * P)),
                tb.TipLoad(force=along_x(-0.2 * P), follower=True),
            ],
        ),
        5.0,
        points=9,
    )
    assert found.divergence and found.frequency == 0
    assert_close(found.factor.item(), math.acos(0.2 / (0.2 - 1)) ** 2, rtol=1e-2, atol=0)


def test_sideways_under_a_tip_load():
    """A strip on edge, stiff in the plane of the load: P L^2 = 4.013 sqrt(EI GJ) (Timoshenko and
    Gere 1961, art. 6.3). The load is an input; batch and gradient in GJ: half the factor over it.
    """
    GJ = torch.tensor([0.5, 2.0], requires_grad=True)

    def of(N, GJ):
        section = tb.Section.from_stiffness(
            EA=INF, GA=INF, GJ=GJ, EI=(INF, 1.0), mass=1.0, inertia=0.0
        )
        beam = tb.Scene(tb.Beam.straight(1.0, N, section), [tb.TipLoad(force=tb.Input("P", 3))])
        return tb.critical_load(beam, 12.0, inputs={"P": torch.tensor([0.0, 0, 1.0])})

    found = of(8, GJ)
    limit = extrapolated(found.factor.detach(), of(16, GJ.detach()).factor)
    assert_close(limit, 4.0126 * GJ.detach().sqrt(), rtol=NEXT_TERM, atol=0)
    (slope,) = torch.autograd.grad(found.factor.sum(), GJ)
    assert_close(slope, (found.factor / GJ / 2).detach(), rtol=1e-3, atol=0)
    # it gives way to the side
    assert (found.shape[..., -1, 2].abs() < 1e-3 * found.shape[..., -1, 1].abs()).all()


@pytest.mark.steps
def test_the_way_up_ends_at_a_limit_point():
    """A deep arch, clamped at one foot and hinged at the other, P at its crown: kind 3, at the
    largest factor of `path` (each to 1 %: the bracket's tolerance, and steps of 0.2).
    """
    lean = math.radians(107.5)
    section = tb.Section.from_stiffness(EA=1e6, GA=INF, GJ=1.0, EI=1.0, mass=1.0, inertia=0.0)
    arc = tb.Beam.arc(
        1.0, 2 * lean, 4, section, direction=(math.cos(lean), math.sin(lean), 0), up=(0, 0, -1)
    )
    arch = tb.Scene(
        arc,
        [tb.PointLoad(2, force=tb.Input("P", 3))],
        plane="xy",
        supports=(tb.Support(0), tb.Support(-1, "xyz", "xy")),
    )
    P = torch.tensor([0.0, -1.0, 0.0])
    found = tb.critical_load(arch, 14.0, lowest=13.0, points=3, tolerance=1e-2, inputs={"P": P})
    assert found.kind == 3 and found.frequency.isnan()
    path = tb.path(arch, 14.0, load="P", step=0.2, steps=10, inputs={"P": P})
    assert_close(found.factor, path.factor.max(), rtol=2e-2, atol=0)


def test_a_stable_path_has_no_critical_load():
    """A pulled column; and its eigenvalues along the path, the slowest rising."""
    found = tb.critical_load(lambda P: planar(4, tb.TipLoad(force=along_x(P))), 5.0, points=5)
    assert found.kind == 0 and found.factor.isnan() and found.frequency.isnan()
    assert found.eigenvalue.shape == (5, 6) and (found.eigenvalue[:, 0].imag.diff() > 0).all()


@pytest.mark.parametrize(
    "damping", [pytest.param(tb.MassDamping, marks=pytest.mark.long), tb.Damping]
)
def test_a_neighbour_with_damping_changes_nothing(damping):
    """Beck's column without damping alone, and beside one that has some: the same load and
    frequency. What is present decides how it is looked for, not what its value is in some sample.
    """

    def beck(value):
        slowed = damping(torch.tensor(value))
        return tb.critical_load(
            lambda P: planar(3, tb.TipLoad(force=along_x(-P), follower=True), slowed),
            40.0,
            points=9,
        )

    alone, both = beck([0.0]), beck([0.0, 0.01])
    assert both.flutter.all() and both.factor[1] != both.factor[0]
    assert_close(both.factor[:1], alone.factor, rtol=1e-10, atol=0)
    # eigenvalues that meet: rounding by its root
    assert_close(both.frequency[:1], alone.frequency, rtol=1e-7, atol=0)


def test_refusals():
    pull = lambda P: planar(2, tb.TipLoad(force=along_x(-P)))  # noqa: E731
    with pytest.raises(ValueError, match="a highest above the lowest is wanted"):
        tb.critical_load(pull, 1.0, lowest=2.0)
    with pytest.raises(ValueError, match="unstable or without equilibrium at the lowest factor, 5"):
        tb.critical_load(pull, 8.0, lowest=5.0)
    with pytest.raises(ValueError, match="a scene without inputs was given"):
        tb.critical_load(planar(2), 8.0)
    with pytest.raises(ValueError, match="returns Tensor"):
        tb.critical_load(lambda P: P, 8.0)


def test_a_rigid_motion_is_named():
    """A column pinned at both ends may turn about its axis; in a plane it is Euler's, to the 0.7 %
    of 16 elements.
    """
    section = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=0.8, EI=1.0, mass=1.0, inertia=1e-4)
    column = tb.Beam.straight(1.0, 16, section)
    pins = (tb.Support(0, "xyz", ""), tb.Support(-1, "yz", ""))

    def pressed(P, supports, plane=None):
        return tb.Scene(column, [tb.TipLoad(force=along_x(-P))], plane=plane, supports=supports)

    with pytest.raises(
        ValueError, match="nothing holds the rotation about x at node 0 was given; supports"
    ):
        tb.critical_load(lambda P: pressed(P, pins), 15.0, points=5)
    flat = (tb.Support(0, "xyz", "xz"), tb.Support(-1, "yz", "xz"))
    found = tb.critical_load(lambda P: pressed(P, flat, "xz"), 15.0, points=5)
    assert_close(found.factor.item(), math.pi**2, rtol=7e-3, atol=0)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("follower", [False, True])
def test_the_slowest_of_a_long_chain(order, follower):
    """Those of the subspace are those of all, under two loads, before and past the loss: to 1e-8
    (rounding by the condition of the stiffness).
    """
    section = tb.Section.from_stiffness(
        EA=4e4, GA=1e4, GJ=0.8, EI=(1.0, 1.5), mass=1.0, inertia=1e-3
    )
    beam = tb.Beam.straight(1.0, 18 // order, section, order=order)
    load = tb.TipLoad(force=along_x(torch.tensor([-2.0, -30.0])), follower=follower)
    scene = tb.Scene(beam, [load])
    model = discretise(scene)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # buckled
        state = tb.equilibrium(scene)
    M, D, K, _ = of_nodes(model, state, torch.tensor(0.0), {})
    mass, stiffness = of_chain(model, M, K, 6)
    few, every = (
        slow_values(mass, None, stiffness, 6)[0],
        slow_values(*in_basis(model, M, D, K)[0], 6)[0],
    )
    assert few.shape[-1] < every.shape[-1]
    few, want = (x.gather(-1, slow_first(x, 6, False)) for x in (few, every))
    assert_close(few.abs(), want.abs(), rtol=1e-8, atol=0)
    assert_close(few.real, want.real, rtol=0, atol=1e-8 * want.abs().max().item())


def test_a_long_column_needs_no_dense_matrix(monkeypatch):
    """Of 40 elements in a plane (117 unknowns) nothing is dense, backward neither: Euler's load,
    to the 2e-3 by which shear and extension soften it, d(factor)/d(EI) = factor/EI likewise.
    """

    def refused(self):
        raise AssertionError("a dense matrix was made")

    monkeypatch.setattr(FrameworkMatrix, "dense", refused)
    monkeypatch.setattr(BlockChain, "dense", refused)
    EI = torch.tensor(1.0, requires_grad=True)
    section = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=1.0, EI=EI, mass=1.0, inertia=1e-3)
    column = tb.Beam.straight(1.0, 40, section)
    found = tb.critical_load(
        lambda P: tb.Scene(column, [tb.TipLoad(force=along_x(-P))], plane="xz"), 5.0, points=3
    )
    assert found.divergence and found.shape.shape == (41, 6)
    assert_close(found.factor.item(), math.pi**2 / 4, rtol=2e-3, atol=0)
    (slope,) = torch.autograd.grad(found.factor, EI)
    assert_close(slope, found.factor.detach(), rtol=2e-3, atol=0)


def test_equilibria_by_native_code():
    """The same factor, and its derivative by a stiffness, as by eager equilibria, of a beam that
    bends in its stiff plane before it buckles out of it, near Euler's load (3 % above, of four
    elements).
    """
    pytest.importorskip("llvmlite")
    found = []
    for engine in ("compiled", "eager"):
        EI = torch.tensor(1.0, requires_grad=True)
        section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=(EI, 1.3), mass=0.2)
        beam = tb.Beam.straight(1.0, 4, section)
        critical = tb.critical_load(
            lambda P, beam=beam: tb.Scene(
                beam, [tb.TipLoad(force=torch.stack((-P, 0.02 * P, 0 * P), -1))]
            ),
            4.0,
            points=5,
            tolerance=1e-3,
            engine=engine,
        )
        assert 0.8 < critical.factor / (math.pi**2 / 4) < 1.05 and critical.divergence
        (slope,) = torch.autograd.grad(critical.factor, EI)
        found.append(torch.stack((critical.factor.detach(), critical.kind.double(), slope)))
    assert_close(*found, rtol=1e-8, atol=1e-8)


def test_a_beam_that_bends_alone_has_no_critical_load():
    """In its soft plane, to 0.8 of its length: the way on from its shape at one factor led to
    another branch at the next, which was told as buckling at 2.8875 N.
    """
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=(1.0, 1.3), mass=0.2)
    beam = tb.Beam.straight(1.0, 4, section)

    def pressed(P):
        return tb.Scene(beam, [tb.TipLoad(force=torch.stack((-P, 0 * P, 0.02 * P), -1))])

    assert tb.critical_load(pressed, 4.0, points=5, tolerance=1e-3).factor.isnan()


def test_a_bracket_ends_at_rounding():
    """A tolerance below that of numbers finds what the usual one does, to its square."""

    def of(tolerance):
        return tb.critical_load(
            lambda P: planar(2, tb.TipLoad(force=along_x(-P))),
            3.0,
            lowest=2.3,
            points=2,
            count=1,
            tolerance=tolerance,
        ).factor

    assert_close(of(1e-300), of(1e-6), rtol=1e-9, atol=0)


def test_parts_that_do_not_touch_leave_the_chain(monkeypatch):
    """A long column with self contact that is never touched: no dense matrix, and the factor of the
    column without it, to 1e-8.
    """

    def refused(*given):
        raise AssertionError("a dense spectrum was asked for")

    monkeypatch.setattr("torchbeam.math.quadratic_eigen.spectrum", refused)
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=(1.0, 1.3), mass=0.2)
    column = tb.Beam.straight(1.0, 18, section)
    alone, beside = (
        tb.critical_load(
            lambda P, more=more: tb.Scene(column, [tb.TipLoad(force=along_x(-P)), *more]),
            4.0,
            points=3,
        ).factor
        for more in ([], [tb.SelfContact(thickness=1e-3, force=1.0, radius=0.01)])
    )
    assert_close(beside, alone, rtol=1e-8, atol=0)


def test_a_rod_that_is_twisted_buckles_into_a_helix():
    """Clamped, and turned about its axis at the other end, which may slide: M L/EI = 8.98682, the
    first zero of tan x = x times 2 (Greenhill 1883), at an angle of M L/GJ, more than two turns. To
    2e-3, of four elements.
    """
    section = tb.Section.from_stiffness(EA=1e6, GA=1e6, GJ=0.7, EI=1.0, mass=1.0, inertia=1e-4)
    beam = tb.Beam.straight(1.0, 4, section, order=2)

    def twisted(angle):
        turn = torch.stack((angle, 0 * angle, 0 * angle), -1)
        held = tb.Support(0), tb.Support(-1, "yz", "xyz", turn=turn)
        return tb.Scene(beam, [], supports=held)

    found = tb.critical_load(twisted, 15.0, lowest=11.0, points=3, tolerance=1e-2)
    assert found.divergence
    assert_close(found.factor, torch.tensor(8.98682 / 0.7), rtol=2e-3, atol=0)


def test_one_branch_is_followed(monkeypatch):
    """A column with a trace of a load across, whose equilibria from no load on are taken on the
    branch that has buckled, and is stable: they are found from one to the next, on the first.
    """

    def column(P):
        return planar(4, tb.TipLoad(force=along_x(-P) + torch.tensor([0.0, 0, 1e-9])))

    want = tb.critical_load(column, 4.0, points=3, tolerance=1e-2).factor
    own, calls = load_path.equilibrium, []

    def buckled(scene, initial=None, **named):
        calls.append(initial is None)
        return own(scene, initial=initial, branch="stable" if initial is None else "first", **named)

    monkeypatch.setattr(load_path, "equilibrium", buckled)
    found = tb.critical_load(column, 4.0, points=3, tolerance=1e-2)
    assert calls[0] and not any(calls[1:])
    assert_close(found.factor, want, rtol=1e-4, atol=0)


def test_a_bent_column_is_followed_in_few_iterations(monkeypatch):
    """Beside a spring that is off its axis a column is bent from the start: each equilibrium is
    found from one nearby, 47 iterations in all where there were 1,192 from no load on.
    """
    iterations, own = [], load_steps.newton

    def counted(*args, **named):
        outcome = own(*args, **named)
        iterations.append(int(outcome.iterations.max()))
        return outcome

    monkeypatch.setattr(load_steps, "newton", counted)
    spring = tb.Spring(-1, stiffness=5.0, offset=(0, 0, 0.1))
    section = tb.Section.rectangle(0.03, 0.002, 69e9, 0.33, 2700.0)
    beam = tb.Beam.straight(1.0, 8, section)
    found = tb.critical_load(
        lambda P: tb.Scene(beam, [tb.TipLoad(force=along_x(-P)), spring]), 30.0
    )
    assert found.divergence and sum(iterations) < 100


def test_motions_that_relax_take_no_place_of_those_that_flutter():
    """Beck's column, slightly damped, beside carriages that relax at k/c = 1e-3 1/s: they are the
    slowest, but the column flutters as it does alone.
    """
    section = tb.Section.from_stiffness(EA=1e4, GA=1e4, GJ=1.0, EI=1.0, mass=1.0, inertia=1e-6)
    column = {"column": tb.Beam.straight(1.0, 4, section)}
    names = [f"carriage {k}" for k in range(3)]
    law = dict(axis=(1, 0, 0), stiffness=1.0, damping=1e3)
    carriages = {name: tb.Body(mass=1.0, inertia=1.0, position=(0, 2.0, 0)) for name in names}

    def factor(parts, joints):
        def scene(P):
            force = -P[..., None] * torch.tensor([1.0, 0, 0], dtype=torch.float64)
            push = tb.PointLoad(("column", -1), force=force, follower=True)
            foot = tb.Support(("column", 0))
            effects = [push, tb.Damping(1e-3)]
            return tb.Scene(parts, effects, joints=joints, supports=[foot], plane="xy")

        return tb.critical_load(scene, 30.0, lowest=10.0, points=5, count=3)

    alone = factor(column, [])
    beside = factor(column | carriages, [tb.Slider(None, name, **law) for name in names])
    assert alone.flutter and beside.flutter
    assert torch.allclose(beside.factor, alone.factor, rtol=1e-5)


def two_bars(inertia, elements=1, order=1, high=0.2):
    """Von Mises' truss of half-span 1 m, pinned at its feet and its top, where it is loaded."""
    section = tb.Section.from_stiffness(
        EA=1e6,
        GA=1e6,
        GJ=1e3,
        EI=1e3,
        mass=1.0,
        **({} if inertia is None else {"inertia": inertia}),
    )
    bars = dict(length=math.hypot(1, high), elements=elements, section=section, order=order)
    parts = {
        "left": tb.Beam.straight(direction=(1, 0, high), up=(-high, 0, 1), **bars),
        "right": tb.Beam.straight(
            root=(2, 0, 0), direction=(-1, 0, high), up=(-high, 0, -1), **bars
        ),
    }
    return tb.Scene(
        parts,
        [tb.PointLoad(("left", -1), tb.Input("P", 3))],
        joints=[tb.Hinge(("left", -1), ("right", -1), axis=(0, 1, 0))],
        supports=[tb.Support((name, 0), rotation="xz") for name in parts],
        plane="xz",
    )


@pytest.mark.parametrize("order", [1, 2])
def test_ends_that_turn_without_inertia(order):
    """Bars of one element whose ends nothing but bending resists: the load at which they buckle
    does not ask for the inertia, 1e-6 of it by the bracket; pulled, they are stable.
    """
    push, pull = ({"P": torch.tensor([0, 0, P])} for P in (-4000.0, 4000.0))
    found = [
        tb.critical_load(two_bars(inertia, order=order), 2.0, inputs=push).factor
        for inertia in (None, 1e-3)
    ]
    assert_close(*found, rtol=2e-6, atol=0)
    assert tb.critical_load(two_bars(None, order=order), 2.0, inputs=pull).kind == load_path.STABLE


def test_small_rotations_do_not_buckle():
    beam = tb.Beam.straight(1.0, 4, tb.Section.rectangle(0.03, 0.002, 69e9, 0.33, 2700.0))
    scene = tb.Scene(beam, [tb.TipLoad(tb.Input("P", 3))], small=True)
    with pytest.raises(ValueError, match="small=True"):
        tb.critical_load(scene, 10.0, inputs={"P": (-1.0, 0, 0)})
