"""modes: its ways to the eigenvalues against each other, flags, normalisation, derivatives."""

import math
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.linear.system_matrices import in_basis, of_nodes
from torchbeam.math import quadratic_eigen as eigen
from torchbeam.math.eigen_derivatives import upright
from torchbeam.nodal.discretise import discretise

INF = math.inf


def beam(N=4, *effects, EI=(1.0, 1.3), GJ=0.8, inertia=1e-3, mass=0.2):
    section = tb.Section.from_stiffness(EA=4e4, GA=1.4e4, GJ=GJ, EI=EI, mass=mass, inertia=inertia)
    return tb.Scene(tb.Beam.straight(1.0, N, section), effects)


def test_impossible_shear_is_next_to_impossible():
    """Of a cantilever without stretch and shear, whose tangent has a flexibility 1e-7 L^2/GJ in
    their place, by which a frequency is low: of Timoshenko beams by 2.32, 16.2 and 38.7 L^2/EI
    times that of shear (here of EI/(GA L^2) = 1e-5). To rounding (1e-7), and what 16 elements of
    order 2 have too much of the third (1.7e-6).
    """
    section = tb.Section.from_stiffness(EA=INF, GA=INF, GJ=0.8, EI=1.0, mass=1.0)
    scene = tb.Scene(tb.Beam.straight(1.0, 16, section, order=2), plane="xz")
    exact = torch.tensor([1.8751040687, 4.6940911330, 7.8547574382]).square()
    low = 1 - tb.modes(scene, count=3).frequency / exact
    by_shear = torch.tensor([2.32, 16.2, 38.7]) * 1e-7 / 0.8
    assert ((low - by_shear).abs() < torch.tensor([1e-7, 3e-7, 2e-6])).all()


def following(P):
    return tb.TipLoad(force=torch.stack((-P, 0 * P, 0 * P), -1), follower=True)


@pytest.mark.parametrize(("rigid", "order"), [(False, 1), (True, 1), (False, 2)])
def test_three_ways(rigid, order, monkeypatch):
    """24 elements, or 12 of order 2 with a hinge, bent by a dead load: subspace iteration, dense
    symmetric and dense unsymmetric agree to 1e-9 of the frequency; with EA = GA = inf and no rotary
    inertia (a stiffness matrix of condition 1e10, a singular mass) to 1e-6.
    """
    section = tb.Section.from_stiffness(
        EA=INF, GA=INF, GJ=0.8, EI=(1.0, 1.3), mass=torch.tensor([0.2, 0.5]), inertia=0.0
    )
    load = tb.TipLoad(force=(0.3, 0.5, 1.0))
    scene = (
        tb.Scene(tb.Beam.straight(1.0, 24, section), [load])
        if rigid
        else beam(24, load, mass=torch.tensor([0.2, 0.5]))
    )
    if order == 2:
        mass = torch.tensor([0.2, 0.5])
        section = tb.Section.from_stiffness(
            EA=4e4, GA=1.4e4, GJ=0.8, EI=(1.0, 1.3), mass=mass, inertia=1e-3
        )
        hinged = tb.Support(0, rotation="xz"), tb.Support(13, position="yz", rotation="")
        scene = tb.Scene(tb.Beam.straight(1.0, 12, section, order=2), [load], supports=hinged)
    model, state = discretise(scene), tb.equilibrium(scene, tolerance=1e-12)
    (M, D, K), _ = in_basis(model, *of_nodes(model, state, torch.tensor(0.0), {}))
    assert D is None
    with monkeypatch.context() as patch:
        patch.setattr("torchbeam.linear.modes.slowest", None)  # the dense ways
        fast = tb.modes(scene, state, count=4)
    whole = eigen.lowest((M + M.mT) / 2, (K + K.mT) / 2, torch.zeros(2), 4)[0].sqrt()
    general = eigen.slowest(M, None, K, 4, False, False)
    tolerance = 1e-6 if rigid else 1e-9
    assert (fast.eigenvalue.real == 0).all()
    assert_close(fast.eigenvalue.imag, whole, rtol=tolerance, atol=0)
    assert_close(fast.eigenvalue.imag, general.eigenvalue.imag, rtol=tolerance, atol=0)
    one = fast.shape.flatten(-2)[..., model.constraints.moving.flatten()]
    other = upright(general.right)[0]
    assert_close(one, other.to(one.dtype), rtol=0, atol=1e-4 if rigid else 1e-6)


@pytest.mark.parametrize(
    ("supports", "rigid", "bent"),
    [
        ((tb.Support(0, rotation="xz"),), 1, 15.418),
        ((tb.Support(0, rotation=""),), 3, 15.418),
        ((), 6, 22.373),
    ],
)
def test_rigid_motions_leave_the_others_as_they_are(supports, rigid, bent):
    """A beam that is hinged, pinned or free: its first bending about y after them is
    (Blevins 1979, table 8-1) bent sqrt(EI/(m L^4)), to 2 % on 16 elements; next to no damping and
    next to no follower load take the dense unsymmetric way, to the same frequencies; alone,
    subspace iteration has 16 elements, the dense symmetric way 8. What is rigid does not oscillate,
    by more than rounding of EA = 1e6, and does not grow.
    """
    nearly = ((), (tb.Damping(1e-9),), (tb.TipLoad(force=(0, 0, 1e-9), follower=True),))
    for N in (8, 16):
        section = tb.Section.from_stiffness(
            EA=1e6, GA=4e5, GJ=0.8, EI=(1.0, 1.3), mass=0.2, inertia=1e-4
        )
        scenes = [
            tb.Scene(tb.Beam.straight(1.0, N, section), effects, supports=supports)
            for effects in nearly
        ]
        found = [tb.modes(scene, tb.rest(scene), count=24) for scene in scenes]
        known = found[0].frequency
        assert (known[:rigid] < 1e-3).all() and (known[rigid:] > 1).all()
        for each in found:
            assert not each.unstable.any() and torch.isfinite(each.damping_ratio).all()
            assert_close(
                each.frequency[each.frequency > 1][:5], known[rigid : rigid + 5], rtol=1e-7, atol=0
            )
    assert ((known / (bent * 5**0.5) - 1).abs() < 0.02).any()


def test_a_motion_without_stiffness_and_inertia_is_refused():
    """A pinned column that turns about its axis, of a section without rotary inertia."""
    with pytest.raises(ValueError, match="neither stiffness nor inertia"):
        tb.modes(
            tb.Scene(
                beam(inertia=0.0).beam,
                supports=(tb.Support(0, "xyz", ""), tb.Support(-1, "yz", "")),
            ),
            count=2,
        )


@pytest.mark.parametrize("damping", [0.0, 0.5])
def test_motions_without_inertia_are_no_modes(damping):
    """Turns of two elements without rotary inertia: two in a plane, six in space. The slowest are
    those beside next to none.
    """
    drag = [tb.MassDamping(damping)] if damping else []
    for plane, known, free in (("xz", 4, 6), (None, 6, 12)):
        without, with_some = (replace(beam(2, *drag, inertia=x), plane=plane) for x in (0.0, 1e-9))
        value = tb.modes(without, count=known).eigenvalue
        assert_close(value, tb.modes(with_some, count=known).eigenvalue, rtol=1e-6, atol=0)
        with pytest.raises(ValueError, match=f"of {free} modes {known} have an inertia"):
            tb.modes(without, count=known + 1)


def test_a_thin_strip_has_all_its_modes():
    """Sections 1 mm and 0.3 mm thick of 1 m: turns of sections, f ~ 1/t, beside bending, f ~ t, of
    whose inertia over stiffness they have a share of 1e-15. Shares of (t/h)^2 apart, 1.6e-5, and
    what rounding mixes of turns alone.
    """
    fastest, slowest = [], []
    for t in (1e-3, 3e-4):
        section = tb.Section.rectangle(0.02, t, E=7e10, nu=0.3, rho=2700.0)
        scene = tb.Scene(tb.Beam.straight(1.0, 4, section), plane="xz")
        frequency = tb.modes(scene, count=12).frequency
        fastest.append(frequency[-1] * t)
        slowest.append(frequency[0] / t)
    assert_close(*fastest, rtol=1e-4, atol=0)
    assert_close(*slowest, rtol=3e-5, atol=0)


def test_modes_that_single_precision_does_not_hold_are_refused():
    """The fastest, of a spring that double precision has a mode of, beside a function that takes
    float32 alone: in its place stood the slowest one's conjugate.
    """
    matrix = 0.01 * torch.eye(3, dtype=torch.float32)
    pull = tb.Load(lambda x, R, v, w, t: (-v @ matrix, None), node=-1)
    section = tb.Section.circle(0.005, E=2e11, nu=0.3, rho=7800.0)
    scene = tb.Scene(
        tb.Beam.straight(1.0, 8, section),
        [tb.MassDamping(0.5), tb.RootSpring((1e12, 1e10)), pull],
        plane="xz",
        dtype=torch.float32,
    )
    with pytest.warns(UserWarning, match="that take no other"):
        assert (tb.modes(scene, count=5).eigenvalue.imag > 0).all()
        with pytest.raises(ValueError, match="of 27 modes 26 have an inertia"):
            tb.modes(scene, count=27)


def test_buckled_columns_are_found_by_either_way():
    """A column at 0.9 and 1.1 of Euler's load, on few and on many elements: the second diverges, at
    a real eigenvalue.
    """
    for N in (4, 24):
        critical = tb.critical_load(
            lambda P, N=N: beam(N, tb.TipLoad(force=torch.stack((-P, 0 * P, 0 * P), -1))), 4.0
        ).factor
        P = critical * torch.tensor([0.9, 1.1])
        with pytest.warns(RuntimeWarning, match="unstable"):
            found = tb.modes(
                beam(N, tb.TipLoad(force=torch.stack((-P, 0 * P, 0 * P), -1))), count=3
            )
        assert found.divergence.sum(-1).tolist() == [0, 1] and not found.flutter.any()
        assert found.eigenvalue[1, 0].real > 1 and (found.frequency[1] == 0).sum() == 1


def test_flutter_is_told_from_divergence():
    """Beck's column at P = 19 and 22 EI/L^2 (20.05 is critical, 1.5 % more on 16 elements): one
    mode of the second grows and oscillates.
    """
    found = tb.modes(
        beam(16, following(torch.tensor([19.0, 22.0])), EI=(1.0, 300.0), inertia=1e-5), count=3
    )
    assert found.unstable.sum(-1).tolist() == [0, 1] and torch.equal(found.flutter, found.unstable)


@pytest.mark.parametrize("effects", [(), (tb.Damping(0.01),)])
def test_normalised_by_mass(effects):
    scene = beam(4, *effects)
    found, model = tb.modes(scene, count=3, normalize="mass"), discretise(scene)
    (M, *_), _ = in_basis(model, *of_nodes(model, tb.rest(scene), torch.tensor(0.0), {}))
    M = M.to(found.shape.dtype)
    v = found.shape[:, 1:].flatten(-2)
    assert_close(
        torch.einsum("ki,ij,kj->k", v.conj(), M, v),
        torch.ones(3, dtype=v.dtype),
        rtol=1e-10,
        atol=1e-10,
    )
    if not effects:  # and orthogonal
        assert_close(v.conj() @ M @ v.mT, torch.eye(3, dtype=v.dtype), rtol=0, atol=1e-9)
    assert_close(
        found.shape[..., :3, :],
        tb.modes(scene, count=3).shape[..., :3, :]
        * found.shape.abs().amax((-1, -2), True).to(v.dtype),
        rtol=1e-9,
        atol=1e-9,
    )


KINDS = {
    "conservative": (3, ()),
    "damped": (3, (tb.Damping(0.01),)),
    "follower": (3, (following(torch.tensor(5.0)),)),
    "many": (20, ()),
}


@pytest.mark.parametrize("normalize", ["largest", "mass"])
@pytest.mark.parametrize("kind", KINDS)
def test_derivatives(kind, normalize):
    """Of eigenvalues and shapes by EI, GJ and mass of a beam bent by a dead load, backward and
    forward, against central differences (1e-5 apart, tolerance of the equilibrium 1e-12: 2e-6 of
    the largest; with many elements 1e-4 apart and 1e-5, for subspace iteration leaves up to 1e-10).
    """
    N, effects = KINDS[kind]
    apart = 1e-4 if N > 16 else 1e-5

    def of(p):
        scene = beam(
            N, tb.TipLoad(force=(0.1, 0.3, 0.4)), *effects, EI=(p[0], 1.3 * p[0]), GJ=0.8 * p[1],
            mass=0.2 * p[2],
        )  # fmt: skip
        found = tb.modes(
            scene, tb.equilibrium(scene, tolerance=1e-12), count=2, normalize=normalize
        )
        value = torch.view_as_real(found.eigenvalue)
        shape = torch.view_as_real(found.shape[..., 1:, :])
        weight = torch.cos(torch.arange(shape.numel()).reshape(shape.shape).to(shape))
        return torch.stack((*value.flatten(), (weight * shape).sum()))

    p = torch.ones(3)
    way = torch.tensor([1.0, -0.7, 0.4])
    wanted = (of(p + apart * way) - of(p - apart * way)) / (2 * apart)
    size = wanted.abs().max().item()
    forward = torch.func.jvp(of, (p,), (way,))[1]
    assert_close(forward, wanted, rtol=0, atol=(1e-5 if N > 16 else 2e-6) * size)
    leaf = p.clone().requires_grad_()
    values = of(leaf)
    for k in (1, len(values) - 1):
        (slope,) = torch.autograd.grad(values[k], leaf, retain_graph=True)
        assert_close(slope @ way, forward[k], rtol=0, atol=1e-7 * size)


def test_repeated_eigenvalues_have_no_derivative():
    """A round section bends alike in two planes: a sentence, not NaN; its first torsion or
    stretching mode has one.
    """
    EI = torch.tensor(1.0, requires_grad=True)
    found = tb.modes(beam(3, EI=EI, inertia=1e-2), count=6)
    torsion = int(found.shape[:, -1, 3].abs().argmax())
    (slope,) = torch.autograd.grad(found.frequency[torsion], EI, retain_graph=True)
    assert slope.abs() < 1e-6
    with pytest.raises(RuntimeError, match="derivative of a repeated eigenvalue"):
        torch.autograd.grad(found.frequency[0], EI)


def test_refusals():
    with pytest.raises(
        ValueError, match="normalize = 'unit' was given; 'largest', 'mass' are there"
    ):
        tb.modes(beam(), normalize="unit")


@pytest.mark.parametrize("order", [1, 2])
def test_units_do_not_matter(order):
    """A long beam with a stiffness of 1e-12 N m^2 and a mass of as little has the frequencies of
    one of 1: what stands for held moves in its matrix has the size of the others. To 1e-8, as
    rounding of stiff strains leaves.
    """

    def frequencies(size):
        section = tb.Section.from_stiffness(
            EA=1e4 * size, GA=1e4 * size, GJ=0.8 * size, EI=(size, 1.5 * size), mass=size,
            inertia=1e-3 * size,
        )  # fmt: skip
        beam = tb.Beam.straight(1.0, 24 // order, section, order=order)
        pins = (tb.Support(0, "xyz", "xy"), tb.Support(-1, "yz", ""))
        return tb.modes(tb.Scene(beam, supports=pins)).frequency

    assert_close(frequencies(1e-12), frequencies(1.0), rtol=1e-8, atol=0)


def test_small_motions_are_damped_by_drag_in_a_flow():
    """Small rotations do not turn the beam in the flow, so that the drag reads velocities alone:
    it damps as much as beside a load of zero that reads places too.
    """
    section = tb.Section.from_stiffness(EA=100.0, GA=50.0, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-3)
    drag = tb.Drag(10.0, 0.1, flow=(0.3, 0.5, 0.2))

    def ratios(*more):
        scene = tb.Scene(tb.Beam.straight(1.0, 2, section), [drag, *more], small=True)
        return tb.modes(scene, count=2).damping_ratio

    alone = ratios()
    assert (alone > 0.1).all()
    torch.testing.assert_close(alone, ratios(tb.Spring(1, 0.0, (0.3, 0.2, 0.1))), rtol=1e-9, atol=0)


@pytest.mark.parametrize(
    ("elements", "order", "percent"),
    [(16, 1, (-0.03, 0.43, 1.50, 3.28)), (8, 2, (0.0, 0.0, 0.0, 0.05))],
)
def test_frequencies_of_a_mesh_are_as_docs_say(elements, order, percent):
    """docs/linear.md: of a slender cantilever, over Euler and Bernoulli's (beta_k L)^2
    sqrt(EI/(m L^4)), whose shear and rotary inertia are 0.01 % here.
    """
    strip = tb.Section.rectangle(width=0.03, height=0.002, E=69e9, nu=0.33, rho=2700.0)
    beam = tb.Beam.straight(1.0, elements, strip, order=order)
    roots = torch.tensor([1.8751041, 4.6940911, 7.8547574, 10.9955407], dtype=torch.float64)
    exact = roots.square() * (69e9 * 0.002**2 / 12 / 2700.0) ** 0.5
    error = 100 * (tb.modes(tb.Scene(beam, plane="xz"), count=4).frequency / exact - 1)
    wanted = torch.tensor(percent, dtype=torch.float64)
    assert_close(error, wanted, rtol=0, atol=0.011)
