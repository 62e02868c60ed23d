"""Growth of rotors, whatever the speeds and how many modes are asked for."""

import math

import numpy as np
import pytest

import torchbeam as tb


def growth(W, m, k, c):
    """1/s: of m (u'' - 2 W v' - W^2 u) + c (u' - W v) + k_1 u = 0, and v likewise, in axes that
    turn (Smith 1933, Proc. R. Soc. A 142, 92; Genta 2005, Dynamics of Rotating Systems, ch. 6).
    """
    D = np.array([[c, -2 * m * W], [2 * m * W, c]])
    K = np.array([[k[0] - m * W**2, -c * W], [c * W, k[1] - m * W**2]])
    below = -np.hstack((K, D)) / m
    return np.linalg.eigvals(np.vstack((np.eye(4)[2:], below))).real.max()


def zero(f, a, b):
    """Where f changes its sign, by halves."""
    for _ in range(60):
        middle = (a + b) / 2
        a, b = (middle, b) if f(a) * f(middle) > 0 else (a, middle)
    return a


def in_plane(m, k, c_i, c_e):
    """A disc on springs k and dampers c_i that turn with it, in drag c_e; beside it a body on a
    spring, which nothing damps.
    """
    parts = {"arbor": tb.Body(1e-9, 1.0), "slide": tb.Body(1e-9, 1e-9), "disc": tb.Body(m, 0.1)}
    parts["other"] = tb.Body(1.0, 1.0)
    joints = [
        tb.Hinge(None, "arbor", axis=(0, 0, 1)),
        tb.Slider("arbor", "slide", axis=(1, 0, 0), stiffness=k[0], damping=c_i),
        tb.Slider("slide", "disc", axis=(0, 1, 0), stiffness=k[1], damping=c_i),
        tb.Hinge(None, "other", axis=(0, 0, 1), stiffness=150.0),
    ]
    drag = tb.Load(lambda x, R, v, w, t: (-c_e * v, None), node="disc", of=("velocity",))
    return tb.Scene(parts, [drag], joints=joints, plane="xy")


def check_growth(diagram, speed, growing, within, ends):
    """Of 1/s, and, relatively, of the ends of the range: by the modes where they are all, and by
    `growth` and the range anyway.
    """
    closed = [max(0.0, growing(W)) for W in speed]
    np.testing.assert_allclose(diagram.growth, closed, atol=within)
    if len(diagram.names) > 1:
        largest = diagram.eigenvalue.real.amax(-1).clamp(min=0)
        np.testing.assert_allclose(largest, closed, atol=within)
    low = max(speed[0], zero(growing, 0.8 * 178, 178))
    high = min(speed[-1], zero(growing, 178, 1.2 * 178))
    np.testing.assert_allclose(diagram.unstable_ranges, [(low, high)], rtol=ends)


FLAT = [
    (160, 175, 180, 200), (165, 170, 175, 180, 185, 190), (175, 180), (160, 180), (0, 180, 200)
]  # fmt: skip


@pytest.mark.parametrize("speed, count", [(FLAT[0], 3), (FLAT[1], 1), (FLAT[4], 2)])
def test_springs_that_are_not_alike_grow_between_their_critical_speeds(speed, count):
    """A mode parts into motions of growth s and -s, still in axes that turn: the growing
    one is told, whatever the speeds and the count; the search ends within 1e-6 of the speed.
    """
    m, k, c = 5.0, (140625.0, 178125.0), 20.0
    scene = in_plane(m, k, 0.0, c)
    diagram = tb.campbell(scene, [float(W) for W in speed], bearing=0, count=count)
    assert diagram.method == "multiblade"
    check_growth(diagram, speed, lambda W: growth(W, m, k, c), 1e-9, 2e-6)


@pytest.mark.parametrize(
    "speed, count, c",
    [
        *((speed, count, 20.0) for speed, count in zip(FLAT, (3, 3, 2, 2, 2), strict=True)),
        (FLAT[0], 1, 20.0),
        ((160, 180, 200), 2, 1.0),  # all but undamped: next to nothing decays beside the range
        ((165, 170, 175, 180, 185, 190), 2, 1.0),
    ],
)
def test_a_shaft_that_is_not_round_grows_between_its_critical_speeds(speed, count, c):
    """As springs 48 EI/L^3, where Floquet's exponents part: 3e-4 1/s by its mass, and 1e-3 near the
    onset; the search ends within 1e-3 of the speed.
    """
    m, span, EI = 5.0, 0.8, (1500.0, 1900.0)
    section = tb.Section.from_stiffness(EA=6e7, GA=math.inf, GJ=1e3, EI=EI, mass=1e-4, inertia=1e-7)
    parts = {"pivot": tb.Body(1e-9, 1e-9), "shaft": tb.Beam.straight(span, 2, section, order=2)}
    joints = [
        tb.Hinge("pivot", ("shaft", 0), axis=(1, 0, 0)),
        tb.Ball(None, ("shaft", -1)),
        tb.Universal(None, "pivot", axis=(0, 1, 0), second=(0, 0, 1)),
    ]
    disc = tb.PointMass(m, inertia=(0.02, 0.01, 0.01), node=("shaft", 2))
    drag = tb.Load(lambda x, R, v, w, t: (-c * v, None), node=("shaft", 2), of=("velocity",))
    k = [48 * b / span**3 for b in EI]
    scene = tb.Scene(parts, [disc, drag], joints=joints)
    diagram = tb.campbell(scene, speed, bearing=(0, 1), count=count, steps=16)
    assert diagram.method == "floquet"
    check_growth(diagram, speed, lambda W: growth(W, m, k, c), 2e-3, 1e-3)


@pytest.mark.parametrize(
    "speed, count",
    [
        ((0, 2618), 1),
        ((0, 2618), 3),
        ((0, 45, 60, 200), 3),
        (range(0, 101, 20), 3),
        ((20, 49, 49.9999, 50.0001, 51), 2),
    ],
)
def test_an_undamped_mode_beside_it_does_not_move_the_onset_of_growth(speed, count):
    """Forward whirl grows from w (1 + c_e/c_i) on (Kimball 1924, Gen. Electr. Rev. 27, 244), from
    wherever the speeds come; the search ends within 1e-6 of the speed.
    """
    m, k, c_i, c_e = 2.0, 800.0, 4.0, 6.0
    onset = math.sqrt(k / m) * (1 + c_e / c_i)
    scene = in_plane(m, (k, k), c_i, c_e)
    diagram = tb.campbell(scene, [float(W) for W in speed], bearing=0, count=count)
    assert diagram.method == "multiblade"
    ((low, high),) = diagram.unstable_ranges
    np.testing.assert_allclose((low, high), (onset, speed[-1]), rtol=2e-6)


@pytest.mark.parametrize("count", [2, 3])
def test_floquet_begins_at_rest(count):
    """At a speed of 0 modes are those of the shape as drawn, as many as are asked for."""
    section = tb.Section.rectangle(0.02, 0.03, E=2e11, nu=0.3, rho=7800.0)
    shaft = {"shaft": tb.Beam.straight(0.8, 1, section)}
    turning = tb.Scene(shaft, joints=[tb.Hinge(None, ("shaft", 0), axis=(1, 0, 0))])
    diagram = tb.campbell(turning, [0.0, 500.0], count=count, steps=64)
    held = tb.modes(tb.Scene(shaft, supports=[tb.Support(("shaft", 0))]), count=count)
    assert diagram.method == "floquet"
    np.testing.assert_allclose(diagram.frequency[0].sort()[0], held.frequency, rtol=1e-8)
