"""Slow modes beside stiffnesses that are far apart: slender beams, stiff springs and pieces."""

import math
import random
import warnings

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.linear.system_matrices import dense, of_chain, of_nodes
from torchbeam.math import quadratic_eigen as eigen
from torchbeam.nodal.discretise import discretise

FIRST = 1.8751040687119611**2  # of a cantilever, by sqrt(EI / (m L^4))
DTYPE = torch.float64


def section(slender, *, shear=0.4, times=1.0, inertia=0.0):
    """EA = 1e6 N, L = 1 m; slender: L over the radius of gyration, a number or a tensor."""
    EI = 1e6 / torch.as_tensor(slender, dtype=DTYPE) ** 2
    return tb.Section.from_stiffness(
        EA=1e6 * times, GA=shear * 1e6 * times, GJ=0.8 * EI * times, EI=EI * times,
        mass=torch.tensor(1.0, dtype=DTYPE), inertia=inertia,
    )  # fmt: skip


def frequency(scene, count):
    """By the first one of a slender cantilever of L/r = 1e4."""
    return tb.modes(scene, count=count).frequency / (FIRST * 0.1)


@pytest.mark.parametrize("count", [1, 2, 6])
def test_a_slender_cantilever(count):
    """L/r = 1e3, 1e4 and 1e5 on 40 elements: the first frequency to 1e-3 (discretisation 4e-5,
    rounding 1e-4); it was 2 to 10 times too high. A sample alone is the same one, to rounding.
    """
    slender = torch.tensor([1e3, 1e4, 1e5], dtype=DTYPE)
    beam = tb.Beam.straight(1.0, 40, section(slender))
    found = tb.modes(tb.Scene(beam), count=count).frequency[:, 0] * slender / 1e3
    assert_close(found, torch.full_like(found, FIRST), rtol=1e-3, atol=0)
    alone = tb.modes(tb.Scene(tb.Beam.straight(1.0, 40, section(1e4))), count=count).frequency[0]
    assert_close(alone * 10, found[1], rtol=1e-5, atol=0)


def test_a_slender_cantilever_is_described():
    """Its first frequency, of 240 unknowns, as `modes` has it; it was 1.96 times too high."""
    said = str(tb.describe(tb.Scene(tb.Beam.straight(1.0, 40, section(1e5)))))
    assert float(said.split("frequencies")[1].split(",")[0]) == pytest.approx(FIRST / 100, rel=2e-3)


def test_one_stiff_entry():
    """A spring and an elastic clamp of 1e12 (N/m, N m/rad; EI/L^3 is 0.01), GA = 1e4 EA, and a
    tenth of the beam 1e6 times as stiff: as pinned in the middle, clamped, without shear, and with
    the stiff tenth at the root (Blevins 1979; to 1 % of discretisation).
    """
    beam = tb.Beam.straight(1.0, 40, section(1e4))
    clamp = tb.RootSpring((1e12,) * 6)
    assert_close(frequency(tb.Scene(beam, [clamp], supports=()), 1).item(), 1.0, rtol=1e-3, atol=0)
    pin = tb.Scene(beam, [tb.Spring(40, 1e12, (1.0, 0, 0))])
    assert_close(frequency(pin, 1).item(), 15.418 / FIRST, rtol=1e-2, atol=0)
    stiff = tb.Scene(tb.Beam.straight(1.0, 40, section(1e4, shear=1e4)))
    assert_close(frequency(stiff, 1).item(), 1.0, rtol=1e-2, atol=0)
    root = [section(100.0, times=1e6)] * 4 + [section(100.0)] * 36
    found = frequency(tb.Scene(tb.Beam.straight(1.0, 40, root)), 1).item() / 100
    assert_close(found, 1 / 0.9**2, rtol=1e-2, atol=0)


def test_rounding_is_told():
    """L/r = 1e6 on 40 elements: a sentence; 1e8: nothing is left, and it says so; of a free beam
    zeros are rigid motions, and nothing is said; nor at 1e5.
    """
    for slender, supports, said in [
        (1e6, (tb.Support(0),), "up to [0-9]+% of it"),
        (1e8, (tb.Support(0),), "up to all of it"),
    ]:
        beam = tb.Beam.straight(1.0, 40, section(slender))
        with pytest.warns(UserWarning, match=said):
            tb.modes(tb.Scene(beam, supports=supports), count=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        free = tb.Scene(tb.Beam.straight(1.0, 40, section(1e3, inertia=1e-6)), supports=())
        found = tb.modes(free, count=7).frequency
        tb.modes(tb.Scene(tb.Beam.straight(1.0, 40, section(1e5))), count=1)
    assert (found[:6] == 0).all() and found[6] > 0


def drawn(seed):
    """A scene of random slenderness, with stiff or soft pieces, springs, masses: contrasts up to
    1e12; and how many modes.
    """
    draw = random.Random(seed)
    N, order = draw.choice([(18, 1), (30, 1), (12, 2)])
    slender, L, mass = 10 ** draw.uniform(1, 5.5), 10 ** draw.uniform(-1, 2), draw.uniform(0.1, 9)
    EA = 10 ** draw.uniform(-2, 8)
    EI, GA = EA * (L / slender) ** 2, EA * draw.choice([0.4, 10 ** draw.uniform(-6, 4), math.inf])
    free = draw.random() < 0.3
    inertia = mass * 1e-4 * L**2 if free else draw.choice([0.0, mass * (L / slender) ** 2])

    def piece(times):
        return tb.Section.from_stiffness(
            EA=torch.tensor(EA * times, dtype=DTYPE), GA=GA * times, GJ=0.8 * EI * times,
            EI=(EI * times, EI * times * turn), mass=mass, inertia=inertia,
        )  # fmt: skip

    turn, times = draw.choice([1, 1.3, 1e3]), [1.0] * N
    if draw.random() < 0.5:
        first, size = draw.randrange(N), 10 ** draw.uniform(-3, draw.choice([6, 12]))
        times[first : first + N // 3] = [size] * len(times[first : first + N // 3])
    effects = []
    if draw.random() < 0.4:
        k = 10 ** draw.uniform(-6, 12) * EI / L**3
        effects.append(tb.Spring(draw.randrange(1, N + 1), k, (0.1 * L, 0.2 * L, 0.0)))
    if draw.random() < 0.2:
        effects.append(tb.PointMass(mass * L * 10 ** draw.uniform(-3, 3), node=N))
    if free and draw.random() < 0.5:
        k = 10 ** draw.uniform(-3, 12)
        effects.append(tb.RootSpring((k * EI / L**3,) * 3 + (k * EI / L,) * 3))
    beam = tb.Beam.straight(L, N, [piece(x) for x in times], order=order)
    scene = tb.Scene(beam, effects, supports=() if free else (tb.Support(0),))
    return scene, draw.choice([1, 2, 6])


@pytest.mark.parametrize("seeds", [range(20), pytest.param(range(20, 60), marks=pytest.mark.long)])
def test_long_chains_as_dense(seeds):
    """Subspace iteration and the dense way agree, in random scenes, within twice what both say that
    rounding leaves, and 1e-9, of what is known to 10 %; it converges in nine of ten, and three of
    five are known so well.
    """
    none = sure = 0
    for seed in seeds:
        scene, count = drawn(seed)
        model = discretise(scene)
        M, _, K, _ = of_nodes(model, tb.rest(scene), torch.tensor(0.0, dtype=DTYPE), {})
        chains = of_chain(model, M, K, count)
        few = eigen.slowest_of_chain(*(x.symmetrised() for x in chains), count)
        all_of_it = eigen.slowest(dense(model, M), None, dense(model, K), count, True, False)
        if few is None:
            none += 1
            continue
        known = (few.doubt.amax(-1) < 0.1) & (all_of_it.doubt.amax(-1) < 0.1)
        if known:
            sure += 1
            error = (few.eigenvalue - all_of_it.eigenvalue).abs() / all_of_it.eigenvalue.abs()
            assert (error <= 2 * (few.doubt + all_of_it.doubt) + 1e-9).all(), (seed, error)
    assert none <= len(seeds) / 10 and sure >= 0.6 * len(seeds)


UNITS = {  # kg, m and s in these
    "nm-pN-us": (1e15, 1e9, 1e6),
    "um-uN-s": (1.0, 1e6, 1.0),
    "mm-N-s-t": (1e-3, 1e3, 1.0),
    "km-t-min": (1e-3, 1e-3, 1 / 60),
}
# the way to eigenvalues hangs on the length and on rotary inertia; the rest are long
OWN = {(4, 0.0, "um-uN-s"), (4, 1e-4, "nm-pN-us"), (18, 0.0, "nm-pN-us"), (18, 1e-4, "km-t-min")}


@pytest.mark.parametrize(
    "N, inertia, units",
    [
        pytest.param(N, inertia, units, marks=[pytest.mark.long] * ((N, inertia, units) not in OWN))
        for N in (4, 18)
        for inertia in (0.0, 1e-4)
        for units in UNITS
    ],
)
def test_units(N, inertia, units):
    """Frequencies, damping, rigid motions, poles of the linear model and critical loads of the same
    beam in other units, with and without rotary inertia, by each way to the eigenvalues: to 1e-7
    (rounding), without rotary inertia beside Euler's load to 1e-6.
    """

    def answers(kg, m, s):
        force, t = kg * m / s**2, torch.tensor(s, dtype=DTYPE)
        bar = tb.Section.from_stiffness(
            EA=1e4 * force * t / t, GA=4e3 * force, GJ=0.8 * force * m**2,
            EI=(force * m**2, 1.3 * force * m**2), mass=0.2 * kg / m, inertia=inertia * kg * m,
        )  # fmt: skip
        beam = tb.Beam.straight(1.0 * m, N, bar)
        push = tb.TipLoad(force=tb.Input("P", 3))
        inputs = {"P": torch.tensor([-force, 0, 0], dtype=DTYPE)}
        damped = tb.modes(tb.Scene(beam, [tb.Damping(1e-3 * s)]), count=3).eigenvalue * s
        free = () if inertia == 0 else tb.modes(tb.Scene(beam, supports=()), count=8).frequency * s
        hung = tb.Spring(N, 2.0 * force / m, (1.0 * m, 0.1 * m, 0.0))
        line = tb.linearize(tb.Scene(beam, [push]), inputs={"P": 0 * inputs["P"]})
        poles = torch.linalg.eigvals(line.reduced(3).A).imag * s
        lost = [
            tb.critical_load(tb.Scene(beam, [push, *more]), 4.0, points=5, inputs=inputs).factor
            for more in ((), (tb.TipLoad(force=(0.2 * force, 0, 0), follower=True),))
        ]
        return (
            tb.modes(tb.Scene(beam), count=4).frequency * s,
            tb.modes(tb.Scene(beam, [hung]), count=2).frequency * s, torch.view_as_real(damped),
            torch.as_tensor(free), poles.sort().values, torch.stack(lost),
        )  # fmt: skip

    wanted = answers(1.0, 1.0, 1.0)
    assert wanted[0][0] > 7 and torch.isfinite(wanted[-1]).all()
    for found, want in zip(answers(*UNITS[units]), wanted, strict=True):
        assert_close(found, want, rtol=1e-6, atol=1e-9)


def test_reduced_models_of_slender_beams():
    """EA = 1e10 EI/L^2, hardly any rotary inertia: the slow modes of the linear model are those of
    `modes` to 1e-4 (rounding); they were lost beside the fast ones.
    """
    slim = tb.Section.from_stiffness(
        EA=torch.tensor(1e10, dtype=DTYPE), GA=4e9, GJ=0.8, EI=(1.0, 1.3), mass=1.0, inertia=1e-10
    )
    scene = tb.Scene(tb.Beam.straight(1.0, 8, slim))
    small = tb.linearize(scene).reduced(3)
    found = torch.linalg.eigvals(small.A).imag.sort().values[-3:]
    assert_close(found, tb.modes(scene, count=3).frequency, rtol=1e-4, atol=0)
    assert_close(small.reads @ small.moves, torch.eye(6, dtype=DTYPE), rtol=0, atol=1e-12)


@pytest.fixture(scope="module")
def bent():
    """A round column at 1.6 times Euler's load, on a few elements and on many: (beam, load,
    equilibrium).
    """
    of = tb.Section.from_stiffness(EA=1e5, GA=4e4, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-6)
    push = tb.TipLoad(force=(-1.6 * torch.pi**2 / 4, 0, 0))
    beams = [tb.Beam.straight(1.0, N, of) for N in (4, 18)]
    return [(beam, push, tb.equilibrium(tb.Scene(beam, [push]), relax=True)) for beam in beams]


@pytest.mark.parametrize("count", [1, 2, 4])
def test_a_motion_that_nothing_resists_is_no_contrast(bent, count):
    """A round column past Euler's load is bent in one plane, and the plane turns freely: rounding
    leaves nothing of that frequency, and nothing is said, for others are known, asked for or not,
    damped or not; nor does that motion grow.
    """
    for beam, push, state in bent:
        for beside in [(), (tb.MassDamping(2.0),), (tb.MassDamping(0.01),), (tb.Damping(1e-3),)]:
            with warnings.catch_warnings():
                warnings.simplefilter("error", UserWarning)
                found = tb.modes(tb.Scene(beam, [push, *beside]), state, count=count)
            assert found.frequency[0] < 1e-3 and not found.unstable.any()
