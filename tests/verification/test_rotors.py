"""Rotors on supports that stand, against closed forms and models of one's own."""

import math

import numpy as np
import pytest
import torch

import torchbeam as tb

# Hammond (1974), J. Am. Helicopter Soc. 19(4), 14: a helicopter's four blades on lag hinges, on a
# hub whose springs and masses differ along x and y. kg, m, N s/m, N/m
BLADE = dict(mass=94.9, S=289.1, I=1084.7, offset=0.3048, damping=4067.5)
HUB = dict(mass=(8026.6, 3283.6), stiffness=(1240481.8,) * 2, damping=(51078.7, 51078.7 / 2))


def helicopter(dampers=(BLADE["damping"],) * 4, hub=HUB):
    """In the plane of the rotor; the bearing is joint 0."""
    masses, lever = hub["mass"], BLADE["S"] / BLADE["mass"]
    about_centre = BLADE["I"] - BLADE["mass"] * lever**2
    parts = {
        "carriage": tb.Body(mass=masses[0] - masses[1] or 1e-6, inertia=1.0),
        "mast": tb.Body(mass=masses[1], inertia=1.0),
        "hub": tb.Body(mass=1e-6, inertia=1e-6),
    }
    joints = [tb.Hinge("mast", "hub", axis=(0, 0, 1))]
    for name, axis, k in (("carriage", (1, 0, 0), 0), ("mast", (0, 1, 0), 1)):
        law = dict(stiffness=hub["stiffness"][k], damping=hub["damping"][k])
        joints.append(tb.Slider("carriage" if k else None, name, axis=axis, **law))
    for k, damping in enumerate(dampers):
        angle = 2 * math.pi * k / len(dampers)
        out = torch.tensor([math.cos(angle), math.sin(angle), 0.0], dtype=torch.float64)
        name, place = f"blade {k}", (BLADE["offset"] + lever) * out
        parts[name] = tb.Body(mass=BLADE["mass"], inertia=about_centre, position=place)
        hinge = dict(at=BLADE["offset"] * out, axis=(0, 0, 1), damping=damping)
        joints.append(tb.Hinge("hub", name, **hinge))
    return tb.Scene(parts, joints=joints, plane="xy")


def coleman(psi, speed, dampers, hub=HUB):
    """M, D, K of x, y of the hub and the blades' lag angles, at an azimuth: Coleman and Feingold
    (1958), NACA Report 1351, with the angles in axes that turn.
    """
    n, S = len(dampers), BLADE["S"]
    M, D, K = (np.zeros((n + 2, n + 2)) for _ in range(3))
    for k in range(2):
        M[k, k] = hub["mass"][k] + n * BLADE["mass"]
        D[k, k], K[k, k] = hub["damping"][k], hub["stiffness"][k]
    for k, damping in enumerate(dampers, 2):
        angle = psi + 2 * math.pi * (k - 2) / n
        across = np.array([-math.sin(angle), math.cos(angle)])  # d/dpsi = -out
        out = np.array([math.cos(angle), math.sin(angle)])
        M[k, k], D[k, k], K[k, k] = BLADE["I"], damping, speed**2 * BLADE["offset"] * S
        M[:2, k] = M[k, :2] = S * across
        D[:2, k], K[:2, k] = -2 * speed * S * out, -(speed**2) * S * across
    return M, D, K


def exponents(speed, *of, steps=400):
    """Real parts of the exponents over a turn, by Runge and Kutta's method of fourth order."""
    h, n = 2 * math.pi / speed / steps, len(coleman(0.0, speed, *of)[0])

    def rates(psi):
        M, D, K = coleman(psi, speed, *of)
        below = -np.linalg.solve(M, np.hstack((K, D)))
        return np.vstack((np.hstack((np.zeros((n, n)), np.eye(n))), below))

    X = np.eye(2 * n)
    for step in range(steps):
        A, B, C = (rates(2 * math.pi * (step + s) / steps) for s in (0, 0.5, 1))
        a = A @ X
        b = B @ (X + h / 2 * a)
        c = B @ (X + h / 2 * b)
        X = X + h / 6 * (a + 2 * b + 2 * c + C @ (X + h * c))
    return np.sort(np.log(np.abs(np.linalg.eigvals(X))) * speed / (2 * math.pi))


C = BLADE["damping"]


@pytest.mark.parametrize("dampers", [(C,) * 4, (0.0, C, C, C), (C, C), (C, C, 2 * C)])
def test_ground_resonance_is_that_of_coleman_and_feingold(dampers):
    """Growth of all motions, of four equal blades, one damper inoperative, two blades, and three
    unequal ones; within the steps of both (400 of fourth order, 48 of sixth).
    """
    speed = torch.tensor([16.0, 26.0], dtype=torch.float64)
    count = len(dampers) + 2
    diagram = tb.campbell(helicopter(dampers), speed, bearing=0, count=count, steps=48)
    assert diagram.method == (
        "multiblade" if len(set(dampers)) == 1 < len(dampers) - 1 else "floquet"
    )
    for W, value in zip(speed.tolist(), diagram.eigenvalue, strict=True):
        expected = exponents(W, dampers)[::2]
        np.testing.assert_allclose(np.sort(value.real), expected, rtol=0, atol=2e-6)


def test_ground_resonance_with_a_damper_inoperative_has_hammonds_range():
    """Hammond's rotor is stable with all dampers. With one inoperative a lag mode grows about where
    its regressing frequency meets the hub's (own model: 22.03 to 32.17 rad/s).
    """
    speed = torch.tensor([20.0, 22.0, 22.1, 32.1, 32.3], dtype=torch.float64)
    whole = tb.campbell(helicopter(), speed, bearing=0)
    assert whole.method == "multiblade" and not whole.unstable.any()
    less = tb.campbell(helicopter((0.0, C, C, C)), speed, bearing=0)
    assert less.unstable.any(-1).tolist() == [False, False, True, True, False]
    ((low, high),) = less.unstable_ranges
    assert 22.0 < low < 22.1 and 32.1 < high < 32.3


def test_a_disc_on_a_shaft_splits_by_its_gyroscopic_moment():
    """Overhung disc on a massless shaft, z = y + i z and slope p: m z'' + 12 b z - 6 b L p = 0,
    Jd p'' - i Jp W p' - 6 b L z + 4 b L^2 p = 0, b = EI/L^3.
    """
    L, EI, m, Jp, Jd = 1.0, 1650.0, 2.0, 0.08, 0.05
    section = tb.Section.from_stiffness(EA=1e8, GA=math.inf, GJ=1e6, EI=EI, mass=1e-9)
    disc = tb.Body(mass=m, inertia=(Jp, Jd, Jd), position=(L, 0, 0))
    scene = tb.Scene(
        {"shaft": tb.Beam.straight(L, 1, section, order=2), "disc": disc},
        joints=[tb.Hinge(("shaft", -1), "disc", axis=(1, 0, 0))],
        supports=[tb.Support(("shaft", 0))],
    )
    speed = torch.tensor([0.0, 100.0, 300.0], dtype=torch.float64)
    diagram = tb.campbell(scene, speed, count=4)
    for W, found in zip(speed.tolist(), diagram.frequency, strict=True):
        poly = np.polymul([-m, 0, 12 * EI / L**3], [-Jd, Jp * W, 4 * EI / L])
        roots = np.roots(np.polysub(poly, [(6 * EI / L**2) ** 2]))
        # rounding of EA beside EI, and of a shaft with next to no mass
        np.testing.assert_allclose(np.sort(found), np.sort(np.abs(roots.real)), rtol=1e-5)
    assert torch.allclose(diagram.whirl[-1].abs(), torch.ones(4, dtype=torch.float64))
    assert {name.split()[0] for name in diagram.names} == {"forward", "backward"}


def test_a_shaft_between_bearings_whirls_as_rayleighs_beam():
    """Pinned-pinned round shaft with rotary inertia: (m + J k^2) w^2 - 2 J k^2 W w - EI k^4 = 0
    with k = n pi/L (Lee, Katz, Ulsoy and Scott 1988, J. Appl. Mech. 55, 141, without shear).
    """
    L, r, E, rho = 1.0, 0.05, 200e9, 7800.0
    A, inertia = math.pi * r**2, math.pi * r**4 / 4
    section = tb.Section.from_stiffness(
        EA=E * A, GA=math.inf, GJ=E * inertia, EI=E * inertia, mass=rho * A, inertia=rho * inertia
    )
    ends = (
        ("pivot", tb.Body(mass=1e-9, inertia=1e-9)),
        ("shaft", tb.Beam.straight(L, 4, section, order=2)),
    )
    scene = tb.Scene(
        dict(ends),
        joints=[
            tb.Hinge("pivot", ("shaft", 0), axis=(1, 0, 0)),
            tb.Ball(None, ("shaft", -1)),
            tb.Universal(None, "pivot", axis=(0, 1, 0), second=(0, 0, 1)),
        ],
    )
    speed = torch.tensor([0.0, 1000.0, 5000.0], dtype=torch.float64)
    found = tb.campbell(scene, speed, bearing=(0, 1), count=2).frequency
    k = math.pi / L
    a, c = rho * A + rho * inertia * k**2, E * inertia * k**4
    for W, frequency in zip(speed.tolist(), found, strict=True):
        b = rho * inertia * k**2 * W
        root = math.sqrt(b**2 + a * c)
        # four elements: 2e-5, of fourth order in their number
        np.testing.assert_allclose(np.sort(frequency), [(root - b) / a, (root + b) / a], rtol=3e-5)


# an elastic shaft almost without mass, pinned, with a disc in the middle: m, m, kg, N/m
SPAN, DISC = 0.8, 5.0
BENDING = 210e9 * math.pi * 0.01**4 / 4
STIFFNESS = 48 * BENDING / SPAN**3


def jeffcott(effects=(), bearings=None, slides=False):
    """bearings: (stiffness, damping) of each by y and by z, None = rigid; slides: whether the last
    one leaves the shaft's length free.
    """
    section = tb.Section.from_stiffness(
        EA=1e9, GA=math.inf, GJ=1e4, EI=BENDING, mass=1e-6, inertia=1e-10
    )
    parts = {"pivot": tb.Body(1e-9, 1e-9), "shaft": tb.Beam.straight(SPAN, 4, section, order=2)}
    axes, joints, ends = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}, [], []
    for name, place in (("left", 0.0), ("right", SPAN)):
        laws = {} if bearings is None else dict(zip("yz", bearings, strict=True))
        laws |= {"x": (0.0, 0.0)} if slides and place else {}
        end = None
        for axis, (k, c) in laws.items():
            parts[f"{name} {axis}"] = tb.Body(1e-6, 1e-9, position=(place, 0, 0))
            law = dict(axis=axes[axis], stiffness=k, damping=c)
            joints.append(tb.Slider(end, f"{name} {axis}", **law))
            end = f"{name} {axis}"
        ends.append(end)
    first = tb.Hinge("pivot", ("shaft", 0), axis=(1, 0, 0)), tb.Ball(ends[1], ("shaft", -1))
    held = tb.Universal(ends[0], "pivot", axis=(0, 1, 0), second=(0, 0, 1))
    disc = tb.PointMass(DISC, inertia=(0.025, 0.0125, 0.0125), node=("shaft", 4))
    return tb.Scene(parts, [disc, *effects], joints=[*first, held, *joints])


@pytest.mark.parametrize("ratio", [0.0, 0.5, 1.0, 2.0])
def test_internal_damping_has_kimballs_onset(ratio):
    """m s^2 + (c_i + c_e) s + k - i W c_i = 0 of y + i z: damping that turns with the shaft,
    c_i = tau k of `Damping`, and c_e that stands. Forward whirl grows from W = w (1 + c_e/c_i) on
    (Kimball 1924, Gen. Electr. Rev. 27, 244; Genta 2005, Dynamics of Rotating Systems, ch. 4).
    Stretching, overdamped here, is left out: two modes are the two whirls.
    """
    tau = 2e-4
    c = tau * STIFFNESS

    def drag(x, R, v, w, t):
        return -ratio * c * v, None

    effects = [tb.Load(drag, node=("shaft", 4)), tb.Damping(tau)]
    onset = math.sqrt(STIFFNESS / DISC) * (1 + ratio)
    speed = torch.linspace(0.99 * onset, 1.01 * onset, 3, dtype=torch.float64)
    diagram = tb.campbell(jeffcott(effects), speed, bearing=(0, 1), count=2)
    assert diagram.names == ["backward 1", "forward 1"]
    for W, value in zip(speed.tolist(), diagram.eigenvalue, strict=True):
        roots = np.roots([DISC, (1 + ratio) * c, STIFFNESS - 1j * W * c])
        roots = np.where(roots.imag < 0, roots.conj(), roots)
        # the shaft's length is held by its ends, and has mass: 2e-6 of the frequency
        near = np.abs(roots[:, None] - value.numpy()).min(0)
        assert (near < 3e-6 * abs(roots[0])).all()
    ((low, _),) = diagram.unstable_ranges
    np.testing.assert_allclose(low, onset, rtol=3e-6)


def test_bearings_with_stiffness_and_damping_by_direction():
    """Shaft and bearings in series: m s^2 + k z/(k + z) = 0 with z = 2 (k_b + c_b s), by y and by
    z. Journals almost without mass relax at rates of k_b/c_b, behind all vibrations.
    """
    laws = (1.2e5, 40.0), (2.5e5, 60.0)
    scene = jeffcott(bearings=laws, slides=True)
    diagram = tb.campbell(scene, [100.0, 200.0], bearing=(0, 1), count=56)  # all
    assert diagram.names[:2] == ["bending 1", "bending 2"]
    assert (diagram.frequency[0, :48] > 100).all() and (diagram.frequency[0, 48:] == 0).all()
    for value, (k, c) in zip(diagram.eigenvalue[0], laws, strict=False):
        both = STIFFNESS * np.array([2 * c, 2 * k])
        roots = np.roots(np.polyadd([DISC * 2 * c, DISC * (2 * k + STIFFNESS), 0, 0], both))
        np.testing.assert_allclose(value, roots[roots.imag > 0][0], rtol=3e-6)
        # beside the mass of the journals: m s/c = 3e-4
        relaxed = diagram.eigenvalue[0, 48:].real.numpy() / roots[roots.imag == 0].real
        assert np.abs(relaxed - 1).min() < 5e-4
    few = tb.campbell(scene, [100.0, 200.0], bearing=(0, 1), count=2)
    assert torch.allclose(few.eigenvalue, diagram.eigenvalue[:, :2], rtol=1e-9)
    assert {c.mode for c in diagram.critical(orders=1)} == {"bending 1", "bending 2"}
    with pytest.raises(ValueError, match="at most 56"):
        tb.campbell(scene, [100.0], bearing=(0, 1), count=57)


def test_overdamped_motions_of_the_shaft_are_no_lines_of_the_picture():
    """Damping of 1/tau = 50 1/s: all that is faster relaxes at that rate, and lies on the axis."""
    speed = torch.linspace(50, 400, 3, dtype=torch.float64)
    diagram = tb.campbell(jeffcott([tb.Damping(2e-2)]), speed, bearing=(0, 1), count=6)
    whirls = ["backward 1", "forward 1"]
    assert diagram.names[:2] == whirls and (diagram.frequency[:, 2:] == 0).all()
    assert torch.allclose(diagram.eigenvalue[:, 2:].real, torch.tensor(-50.0).double(), rtol=1e-3)
    ax = diagram.plot(orders=(1,), unit="rpm")
    assert [line.get_label() for line in ax.lines[:-1]] == whirls
    np.testing.assert_allclose(ax.lines[0].get_xdata(), speed * 30 / math.pi)
    np.testing.assert_allclose(ax.lines[1].get_ydata(), diagram.frequency[:, 1] / (2 * math.pi))
    ray_x, ray_y = ax.lines[2].get_data()
    np.testing.assert_allclose(60 * ray_y[1], ray_x[1])  # 1/rev: rpm/60 = Hz
    assert ax.get_xlabel() == "speed / rpm" and ax.get_ylabel() == "frequency / Hz"


@pytest.mark.parametrize("method", ["multiblade", "floquet"])
def test_a_top_on_a_spring_keeps_its_weight_in_the_bearing(method):
    """A disc spins on a mast that stands on a universal joint with springs k: J p'' - i Jp W p' +
    (k - G) p = 0 of the tilt p, with J about the foot and G the moment of both weights.
    """
    m, L, Jp, Jd, k, g = 2.0, 0.5, 0.08, 0.05, 30.0, 9.81
    mast, height, inertia = 0.7, 0.2, 0.01
    parts = {
        "mast": tb.Body(mass=mast, inertia=inertia, position=(0, 0, height)),
        "disc": tb.Body(mass=m, inertia=(Jd, Jd, Jp), position=(0, 0, L)),
    }
    foot = dict(at=(0, 0, 0), axis=(1, 0, 0), second=(0, 1, 0), stiffness=(k, k))
    bearing = tb.Hinge("mast", "disc", at=(0, 0, 0.35), axis=(0, 0, 1))
    joints = [bearing, tb.Universal(None, "mast", **foot)]
    scene = tb.Scene(parts, [tb.Gravity((0, 0, -g))], joints=joints)
    speed = torch.tensor([0.0, 50.0, 200.0], dtype=torch.float64)
    found = tb.campbell(scene, speed, bearing=0, count=2, method=method).frequency
    J, K = Jd + m * L**2 + inertia + mast * height**2, k - g * (m * L + mast * height)
    for W, frequency in zip(speed.tolist(), found, strict=True):
        root = math.sqrt((Jp * W) ** 2 + 4 * J * K)
        expected = [(root - Jp * W) / (2 * J), (root + Jp * W) / (2 * J)]
        np.testing.assert_allclose(np.sort(frequency), expected, rtol=1e-10)


def blades(count, tower=None, frame=None, speed=0.0):
    """Three or more blades that bend, on a hub; on a tower, the ground, or in a turning frame."""
    section = tb.Section.from_stiffness(
        EA=1e4, GA=math.inf, GJ=1.0, EI=(1.0, 2.0), mass=1.0, inertia=1e-3
    )
    parts = {"hub": tb.Body(mass=0.5, inertia=(0.05, 0.05, 0.08))}
    hub = (
        tb.Weld(None, "hub") if frame else tb.Hinge(tower and ("tower", -1), "hub", axis=(0, 0, 1))
    )
    joints, supports = [hub], ()
    for k in range(count):
        angle = 2 * math.pi * k / count
        out = (math.cos(angle), math.sin(angle), 0)
        parts[f"blade {k}"] = tb.Beam.straight(1.0, 1, section, direction=out, order=2)
        joints.append(tb.Weld("hub", (f"blade {k}", 0)))
    if tower:
        column = tb.Section.from_stiffness(
            EA=1e5, GA=math.inf, GJ=5.0, EI=(4.0, 6.0), mass=1.0, inertia=1e-3
        )
        along = dict(root=(0, 0, -1.0), direction=(0, 0, 1), up=(1, 0, 0), order=2)
        parts["tower"] = tb.Beam.straight(1.0, 1, column, **along)
        supports = [tb.Support(("tower", 0))]
    return tb.Scene(parts, joints=joints, supports=supports, frame=frame)


def test_blades_on_the_ground_have_the_modes_of_a_turning_frame_plus_and_minus_the_speed():
    """Harmonics 0, 1, -1 of three equal blades are seen at w, w + W and |w - W|. Two eigenproblems
    are as near as rounding leaves slow frequencies beside stiff ones: 3e-9 on one processor.
    """
    W = 3.0
    turning = tb.modes(blades(3, frame=tb.Frame(angular_velocity=(0, 0, W))), count=6)
    flap, lag = turning.frequency[[0, 3]].tolist()
    diagram = tb.campbell(blades(3), [W], count=6)
    expected = [abs(w + k * W) for w in (flap, lag) for k in (-1, 0, 1)]
    np.testing.assert_allclose(np.sort(diagram.frequency[0]), np.sort(expected), rtol=1e-7)
    assert sorted(name[:-2] for name in diagram.names) == [
        f"{how} {which}"
        for how in ("flap", "lag")
        for which in ("backward", "collective", "forward")
    ]


def test_floquet_has_the_frequencies_of_multiblade_coordinates():
    """Three equal blades on a tower, as stiff again along y: 32 steps of sixth order a turn, and
    what is said of their error.
    """
    scene, W = blades(3, tower=True), torch.tensor([3.0], dtype=torch.float64)
    exact, steps = (tb.campbell(scene, W, count=4, method=m, steps=24) for m in ("auto", "floquet"))
    assert (exact.method, steps.method) == ("multiblade", "floquet")
    off = (exact.eigenvalue - steps.eigenvalue).abs()
    assert off.max() < 1e-4 and (off <= 3 * steps.error + 1e-7).all()
