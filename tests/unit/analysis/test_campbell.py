"""Campbell diagrams: derivatives, batches, precision, files, pictures, refusals."""

import math

import numpy as np
import pytest
import torch

import torchbeam as tb
from tests.cases.refusals import refusals

SPEED = torch.tensor([0.0, 100.0, 300.0], dtype=torch.float64)
STEADY = dict(method="multiblade")  # wants a steady state


def overhung(EI=1650.0, mass=2.0, effects=(), dtype=None, plane=None, **disc):
    section = tb.Section.from_stiffness(EA=1e7, GA=math.inf, GJ=1e4, EI=EI, mass=0.1)
    inertia = disc.pop("inertia", (0.08, 0.05, 0.05))
    return tb.Scene(
        {
            "shaft": tb.Beam.straight(1.0, 1, section, order=2),
            "disc": tb.Body(mass=mass, inertia=inertia, position=(1.0, 0, 0)),
        },
        effects,
        joints=[tb.Hinge(("shaft", -1), "disc", axis=(1, 0, 0))],
        supports=[tb.Support(("shaft", 0))],
        plane=plane,
        dtype=dtype,
    )


def test_derivatives_by_the_scene_and_the_speed():
    """Of a forward whirl by bending stiffness, mass and speed, against central differences."""

    def frequency(EI, mass, speed):
        return tb.campbell(overhung(EI, mass), speed, count=2).frequency[0, 1]

    x = [torch.tensor(v, dtype=torch.float64) for v in (1650.0, 2.0, [300.0])]
    slopes = torch.autograd.grad(frequency(*(v.requires_grad_() for v in x)), x)
    for k, slope in enumerate(slopes):
        h, about = 1e-4 * x[k].detach(), [v.detach() for v in x]
        up, down = ([v + s * h if j == k else v for j, v in enumerate(about)] for s in (1, -1))
        difference = (frequency(*up) - frequency(*down)) / (2 * h)
        assert torch.allclose(slope, difference, rtol=1e-5), k


def test_derivatives_of_floquets_exponents():
    """By the inertia of a disc that is not round."""

    def growth(J):
        inertia = torch.stack((torch.full_like(J, 0.08), J, torch.full_like(J, 0.05)))
        diagram = tb.campbell(overhung(inertia=inertia), [150.0], count=2, steps=8)
        assert diagram.method == "floquet"
        return diagram.frequency.sum()

    J = torch.tensor(0.04, dtype=torch.float64)
    (slope,) = torch.autograd.grad(growth(J.requires_grad_()), J)
    h, J = 1e-3, J.detach()
    # rounding of multipliers leaves 1e-7 rad/s, and the differences err by h^2
    assert torch.allclose(slope, (growth(J + h) - growth(J - h)) / (2 * h), rtol=1e-3)


def test_floquet_sees_the_frequencies_of_a_round_rotor_from_the_ground():
    """Its motions have one harmonic; multiples of the speed beside it are rounding, and no
    frequencies. Gauss's steps err by (omega dt)^6/100800: 7e-5 of the fastest, 1.4 rad a step.
    """
    speed = [50.0, 100.0, 200.0, 300.0]
    exact, turns = (tb.campbell(overhung(), speed, count=4, method=m) for m in ("auto", "floquet"))
    off = (turns.frequency - exact.frequency).abs()
    assert exact.method == "multiblade" and (off < 1e-4 * exact.frequency).all()
    assert (off < 2 * turns.error + 1e-6).all()


@pytest.mark.parametrize("rho", [1e-6, 1e-3])
@pytest.mark.parametrize("apart, method", [(0.0, "multiblade"), (1e-4, "floquet")])
def test_rounding_of_a_shaft_almost_without_mass_is_no_asymmetry(rho, apart, method):
    """Its own modes are up to 1e9 1/s, whose rounding couples the slow ones by 4e-5 of theirs. A
    disc whose inertia differs by 1e-4 does so by more.
    """
    scene = tb.Scene(
        {
            "shaft": tb.Beam.straight(1.0, 2, tb.Section.circle(0.01, 210e9, 0.3, rho)),
            "disc": tb.Body(2.0, inertia=(0.02, 0.01 + apart * 0.01, 0.01), position=(1.0, 0, 0)),
        },
        joints=[tb.Hinge(None, ("shaft", 0), axis=(1, 0, 0)), tb.Weld(("shaft", -1), "disc")],
    )
    diagram = tb.campbell(scene, [150.0], count=2)
    assert diagram.method == method


def test_columns_have_a_mode_at_each_speed():
    """All of the modes that have inertia, and so a frequency: coordinates without have none."""
    diagram = tb.campbell(overhung(), SPEED, count=9)
    assert torch.isfinite(diagram.eigenvalue).all()
    with pytest.raises(ValueError, match="at most 9, all modes"):
        tb.campbell(overhung(), SPEED, count=10)


def test_a_sample_alone_is_the_same_sample_in_a_batch():
    EI = torch.tensor([1650.0, 2000.0, 2500.0], dtype=torch.float64)
    many = tb.campbell(overhung(EI), SPEED, count=3)
    assert many.eigenvalue.shape == (3, 3, 3) and many.shape.shape == (3, 3, 3, 4, 6)
    alone = tb.campbell(overhung(EI[1]), SPEED, count=3)
    assert torch.allclose(many.eigenvalue[:, 1], alone.eigenvalue, rtol=1e-10, atol=1e-7)
    assert (many.frequency[:, 0] < many.frequency[:, 2]).all()
    with pytest.raises(ValueError, match=r"plot of a diagram with the batch axes \(3,\)"):
        many.plot()


def test_single_precision_is_solved_in_double():
    single = tb.campbell(overhung(dtype=torch.float32), SPEED, count=3)
    assert single.frequency.dtype == torch.float32
    double = tb.campbell(overhung(), SPEED, count=3)
    assert torch.allclose(single.frequency.double(), double.frequency, rtol=1e-5)


def test_a_support_that_a_load_turns_takes_the_axis_along():
    """A mast on a hinge with a spring, which a torque turns by 0.3 rad, whirls as one drawn so."""

    def frequencies(drawn, torque):
        c, s = math.cos(drawn), math.sin(drawn)
        turn = torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]], dtype=torch.float64)
        along = turn[:, 2]
        axes = dict(rotation=turn)
        parts = {
            "mast": tb.Body(mass=1.0, inertia=0.1, position=0.5 * along, **axes),
            "disc": tb.Body(mass=2.0, inertia=(0.05, 0.05, 0.08), position=along, **axes),
        }
        spring = tb.Hinge(None, "mast", at=(0, 0, 0), axis=(0, 1, 0), stiffness=50.0, torque=torque)
        scene = tb.Scene(parts, joints=[tb.Hinge("mast", "disc", at=along, axis=along), spring])
        return tb.campbell(scene, [10.0, 60.0], bearing=0, count=1).frequency

    assert torch.allclose(frequencies(0.0, 15.0), frequencies(0.3, None), rtol=1e-7)


def test_a_rotor_that_turns_freely_swings_against_its_blades():
    """Three discs on a round shaft that turns in a bearing with damping c: det(J s^2 + C s + K) = 0
    of their three angles. Held, the last two swing alone.
    """
    J, k, c = (0.3, 0.5, 0.2), (40.0, 30.0), 0.2
    names = ("hub", "ring", "rim")
    own = (J[0] - 0.1, *J[1:])  # the bearing has the rest
    parts = {name: tb.Body(mass=1.0, inertia=x) for name, x in zip(names, own, strict=True)}
    joints = [tb.Hinge(None, "hub", axis=(0, 0, 1), damping=c, inertia=0.1)] + [
        tb.Hinge(*names[i : i + 2], axis=(0, 0, 1), stiffness=k[i]) for i in (0, 1)
    ]
    scene = tb.Scene(parts, joints=joints, plane="xy")
    first, last = [k[0], -k[0], 0], [0, -k[1], k[1]]
    K = np.array([first, [-k[0], sum(k), -k[1]], last])
    below = -np.diag(1 / np.array(J)) @ np.hstack((K, np.diag([c, 0, 0])))
    roots = np.linalg.eigvals(np.vstack((np.eye(6)[3:], below)))
    roots = roots[roots.imag > 1]
    free = tb.campbell(scene, [5.0], bearing=0, held=False, count=3).eigenvalue[0]
    np.testing.assert_allclose(free[1:], roots[roots.imag.argsort()], rtol=1e-9)
    held = tb.campbell(scene, [5.0], bearing=0, count=2).frequency[0]
    square = np.linalg.eigvals(np.diag(1 / np.array(J[1:])) @ K[1:, 1:])
    np.testing.assert_allclose(held, np.sort(square) ** 0.5, rtol=1e-9)


def test_a_generator_whose_torque_rises_with_the_speed_damps_it():
    """About a speed W the law -k W^2 is a damper of 2 k W: of a hub with a ring on a spring."""
    J, ring, k, spring, W = 0.4, 0.3, 0.02, 50.0, 5.0
    parts = {"hub": tb.Body(mass=1.0, inertia=J), "ring": tb.Body(mass=1.0, inertia=ring)}
    generator = tb.Hinge(None, "hub", axis=(0, 0, 1), torque=lambda rate: -k * rate**2)
    joints = [generator, tb.Hinge("hub", "ring", axis=(0, 0, 1), stiffness=spring)]
    scene = tb.Scene(parts, joints=joints, plane="xy")
    value = tb.campbell(scene, [W], bearing=0, held=False, count=3).eigenvalue[0]
    roots = np.polymul([J, 2 * k * W, spring], [ring, 0, spring])
    roots = np.roots(np.polysub(roots, [spring**2]))
    slow = roots[np.abs(roots).argsort()[:2]].real
    assert value[1].imag > 10
    np.testing.assert_allclose(value[::2], slow[np.abs(slow).argsort()], atol=1e-9)


def test_critical_speeds_lie_where_a_multiple_of_the_speed_meets_a_frequency():
    diagram = tb.campbell(overhung(), torch.linspace(0, 300, 31), count=4)
    for at in diagram.critical(orders=(1, 2)):
        k = diagram.names.index(at.mode)
        frequency = np.interp(at.speed, diagram.speed, diagram.frequency[:, k])
        assert abs(at.order * at.speed - frequency) < 1e-9 * frequency
    assert [at.mode for at in diagram.critical(1)] == [
        "backward 1", "forward 1", "backward 2"
    ]  # fmt: skip
    with pytest.raises(ValueError, match=r"an order = 1\.5"):
        diagram.critical(1.5)


def test_critical_speeds_of_a_batch_with_derivatives():
    """Those of each sample as `critical` of it alone; NaN where a frequency is not met. By the mass
    against central differences.
    """

    def critical(mass):
        return tb.campbell(overhung(mass=mass), torch.linspace(0, 300, 31), count=4).critical_speed

    mass = torch.tensor([1.5, 2.0], dtype=torch.float64)
    speeds = critical(mass)(order=1)
    assert speeds.shape == (2, 4)
    diagram = tb.campbell(overhung(mass=mass[1]), torch.linspace(0, 300, 31), count=4)
    alone = {c.mode: c.speed for c in diagram.critical(orders=1)}
    for name, speed in zip(diagram.names, speeds[1].tolist(), strict=True):
        assert math.isnan(speed) if name not in alone else abs(speed - alone[name]) < 1e-7, name
    assert speeds.isnan().sum() == 2  # the second forward whirl
    m, h = mass[1].clone().requires_grad_(), 1e-3
    (slope,) = torch.autograd.grad(critical(m)()[0], m)
    up, down = (critical(m.detach() + s * h)()[0] for s in (1, -1))
    assert torch.allclose(slope, (up - down) / (2 * h), rtol=1e-5)  # of h^2


def test_position_and_velocity_of_a_load_can_be_stacked():
    """Both have the axis of the speeds."""

    def stacked(x, R, v, w, t):
        force = (0 * x[..., 0], -90.0 * x[..., 1] - v[..., 1], -90.0 * x[..., 2] - v[..., 2])
        return torch.stack(force, -1), None

    def plain(x, R, v, w, t):
        across = torch.tensor([0.0, 1.0, 1.0], dtype=torch.float64)
        return -across * (90.0 * x + v), None

    film = dict(node="disc", of=("position", "velocity"))
    one, other = (
        tb.campbell(overhung(effects=[tb.Load(f, **film)]), SPEED, count=2)
        for f in (stacked, plain)
    )
    assert torch.allclose(one.eigenvalue, other.eigenvalue, rtol=1e-10)


def with_loose_body():
    scene = overhung()
    shaft = tb.Beam.straight(1.0, 1, tb.Section.circle(0.01, 2e11, 0.3, 7800.0))
    parts = {"shaft": shaft, "disc": tb.Body(1.0, 0.1, position=(1.0, 0, 0))}
    parts["loose"] = tb.Body(1.0, 0.1)
    return tb.Scene(parts, joints=scene.joints, supports=[tb.Support(("shaft", 0))])


def with_axes_of_its_own():
    k = torch.tensor([10.0, 20.0], dtype=torch.float64)
    film = tb.Load(lambda x, R, v, w, t: (-k[:, None] * v, None), node="disc", of=("velocity",))
    return overhung(effects=[film])


def test_a_disc_that_is_not_round_is_unstable_between_two_critical_speeds():
    """Jeffcott's rotor whose shaft turns with it and is not round: between the critical speeds of
    its two stiffnesses it grows, w1 < W < w2 (Smith 1933), where nothing is damped.
    """
    m, k1, k2 = 2.0, 800.0, 1250.0
    parts = {"arbor": tb.Body(mass=1e-9, inertia=1.0), "slide": tb.Body(mass=1e-9, inertia=1e-9)}
    parts["disc"] = tb.Body(mass=m, inertia=0.1)
    joints = [
        tb.Hinge(None, "arbor", axis=(0, 0, 1)),
        tb.Slider("arbor", "slide", axis=(1, 0, 0), stiffness=k1),
        tb.Slider("slide", "disc", axis=(0, 1, 0), stiffness=k2),
    ]
    scene = tb.Scene(parts, joints=joints, plane="xy")
    speed = torch.linspace(15.1, 30.1, 31, dtype=torch.float64)
    diagram = tb.campbell(scene, speed, bearing=0, count=2)
    ((low, high),) = diagram.unstable_ranges
    step = 0.5
    assert abs(low - math.sqrt(k1 / m)) < step and abs(high - math.sqrt(k2 / m)) < step


def test_a_damped_whirl_as_fast_as_the_speed_is_no_relaxing_motion():
    """In axes that turn it stands still and decays, as an overdamped motion does."""
    drag = tb.Load(lambda x, R, v, w, t: (-4.0 * v, None), node="disc")
    scene, W = overhung(effects=[drag], inertia=(0.04, 0.05, 0.05)), 40.0
    for _ in range(12):
        W = tb.campbell(scene, [W], count=2).frequency[0, 1].item()
    diagram = tb.campbell(scene, [W], count=2)
    assert diagram.names == ["backward 1", "forward 1"]
    assert abs(diagram.frequency[0, 1] / W - 1) < 1e-7 and (diagram.damping[0] > 0.01).all()


def test_files_and_pictures(tmp_path):
    diagram = tb.campbell(overhung(), SPEED, count=3)
    with np.load(diagram.save(tmp_path / "rotor.npz")) as kept:
        assert np.array_equal(kept["frequency"], diagram.frequency)
        assert np.array_equal(kept["growth"], diagram.growth)
        assert kept["names"].tolist() == diagram.names
    torch.save(diagram, tmp_path / "rotor.pt")
    again = torch.load(tmp_path / "rotor.pt", weights_only=True)
    assert torch.equal(again.eigenvalue, diagram.eigenvalue)
    ax, damping = tb.plot.grid(1, 2)
    diagram.plot(ax, orders=(1,), damping=damping)
    assert [line.get_label() for line in ax.lines[:3]] == diagram.names
    for k, (above, below) in enumerate(zip(ax.lines[:3], damping.lines[:3], strict=True)):
        assert above.get_color() == below.get_color()
        np.testing.assert_array_equal(below.get_ydata(), diagram.damping[:, k])
    assert "multiblade" in repr(diagram)


@refusals(
    (lambda: tb.Scene({"disc": tb.Body(1.0, 1.0)}), {}, "a scene without a Hinge was given"),
    (lambda: overhung(effects=[tb.Gravity((0, 0, -9.81))]), STEADY, "change with its azimuth"),
    (lambda: overhung(effects=[tb.Spring("disc", 10.0, to=(1.0, 0, 1.0))]), STEADY,
     "on the rotor that change with its azimuth"),
    (overhung, {"bearing": 3}, "bearing = 3 was given"),
    (overhung, {"method": "hill"}, "method = 'hill'"),
    (overhung, {"speeds": [1.0, 0.5]}, "rising numbers"),
    (overhung, {"speeds": [1.0], "method": "floquet", "count": 2}, "steps = 20. or"),
    (with_loose_body, {}, "6 motions of 'loose' .* that nothing resists"),
    (with_axes_of_its_own, {}, r"axes \(2,\) of its own .* values="),
    (with_axes_of_its_own, {"speeds": [10.0, 20.0, 30.0]}, r"axes \(2,\) of its own .* values="),
    (lambda: overhung(plane="xz"), {}, "not normal to plane='xz'"),
    (lambda: overhung(inertia=(0.08, 0.03, 0.05)), {"method": "multiblade"}, "three or more"),
)  # fmt: skip
def test_refusals(scene, more):
    tb.campbell(scene(), **{"speeds": [100.0], **more})


def test_a_rotor_out_of_balance_on_a_support_that_yields_is_refused():
    scene = overhung()
    heavy = tb.Scene(
        {"shaft": tb.Beam.straight(1.0, 1, tb.Section.circle(0.01, 2e11, 0.3, 7800.0), order=2),
         "disc": tb.Body(mass=1.0, inertia=0.1, position=(1.0, 0, 0.01))},
        joints=[tb.Hinge(("shaft", -1), "disc", at=(1.0, 0, 0), axis=(1, 0, 0))],
        supports=scene.supports.given,
    )  # fmt: skip
    with pytest.raises(ValueError, match="out of balance"):
        tb.campbell(heavy, [100.0], **STEADY)
