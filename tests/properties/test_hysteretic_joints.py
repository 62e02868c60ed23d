"""Joints with laws that have a memory, and drives by angle and rate: in motion, by both engines, in
batches, with gradients, at rest, in modes.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals

SECTION = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-3)
G = tb.Gravity((0, 0, -9.81))
INERTIA = 0.2


def wheel(**law):
    """A body of inertia 0.2 kg m^2 on a hinge, driven by 3 sin 4 t."""
    body = tb.Body(mass=1.0, inertia=INERTIA, position=(0, 0, 0))
    motor = {"torque": lambda t: 3.0 * torch.sin(4 * t)} | law
    return tb.Scene({"wheel": body}, joints=[tb.Hinge(None, "wheel", axis=(0, 0, 1), **motor)])


def turned(scene, step, end=0.6):
    t = torch.linspace(0, end, round(end / step) + 1, dtype=torch.float64)
    return tb.simulate(scene, t, step=step, tolerance=1e-13).state


def test_an_oscillator_follows_its_differential_equation():
    """J q'' = 3 sin 4 t - M(q, z) of Bouc and Wen, by scipy's LSODA at 1e-11: second
    order, with a factor that depends on where in a step the wheel turns around.
    """

    def rates(t, y):
        q, v, z = y
        load = 0.1 * 100 * q + 0.9 * 2.0 * z
        way = 0.5 * abs(v) * abs(z) * z + 0.5 * v * z**2
        return v, (3 * math.sin(4 * t) - load) / INERTIA, 50.0 * (v - way)

    exact = solve_ivp(rates, (0, 2.4), (0.0, 0, 0), rtol=1e-11, atol=1e-13, method="LSODA",
                      t_eval=np.linspace(0, 2.4, 5)).y[:, 1:].T  # fmt: skip
    scene, errors = wheel(hysteresis=tb.BoucWen(100.0, 2.0, ratio=0.1, n=2.0)), []
    for step in (0.01, 0.0025):
        rows = turned(scene, step, 2.4).joints[round(0.6 / step) :: round(0.6 / step), 0]
        errors.append(np.abs(rows[:, [0, 3, 12]].numpy() - exact).max(0))
    assert (errors[1] < (1e-4, 5e-4, 4e-4)).all()
    assert (errors[0] / errors[1] > 8).all()


@pytest.mark.parametrize(
    "law",
    [
        tb.ElastoPlastic(100.0, 2.0, hardening=10.0, kinematic=0.6),
        tb.BoucWen(100.0, 2.0, ratio=0.1, n=1.5),
    ],
)
def test_energy_is_kept_or_lost_to_rounding(law):
    """Kinetic energy, what the law stores and what it has lost are the motor's work; no step loses
    less than nothing.
    """
    scene = wheel(hysteresis=law)
    state = turned(scene, 0.02)
    q, rate, memory = state.joints[:, 0, 0], state.joints[:, 0, 3], state.joints[:, 0, 12:]
    energy = INERTIA * rate**2 / 2 + scene.joints[0].hysteresis.stored(q, memory) + memory[:, 1]
    middle = (state.t[1:] + state.t[:-1]) / 2
    work = torch.cumsum(3.0 * torch.sin(4 * middle) * 2 * torch.sin(q.diff() / 2), 0)
    assert_close(energy[1:], work, rtol=0, atol=1e-12)
    assert (memory[:, 1].diff() >= 0).all() and memory[-1, 1] > 0.2


def test_energy_of_bodies_that_tumble():
    """A body on a hinge that yields, another on it by a skew hinge with a loop, falling in space:
    kinetic energy, what laws store and have lost, and what gravity has done, to rounding.
    """
    bodies = {
        "first": tb.Body(mass=1.0, inertia=(0.02, 0.03, 0.04), position=(0.3, 0, 0)),
        "second": tb.Body(mass=0.5, inertia=(0.01, 0.03, 0.02), position=(0.6, 0.2, 0)),
    }
    joints = [
        tb.Hinge(None, ("first", (-0.3, 0.0, 0.0)), axis=(0, 1, 0),
                 hysteresis=tb.ElastoPlastic(80.0, 1.0, hardening=5.0)),
        tb.Hinge(("first", (0.1, 0.1, 0.0)), ("second", (-0.2, -0.1, 0.0)), axis=(1, 0, 1),
                 hysteresis=tb.BoucWen(30.0, 0.3, ratio=0.1, n=2.0)),
    ]  # fmt: skip
    scene = tb.Scene(bodies, [G], joints=joints)
    t = torch.linspace(0, 0.3, 16, dtype=torch.float64)
    solution = tb.simulate(scene, t, step=0.02, tolerance=1e-13)
    state = solution.state
    height = solution.energy.kinetic.new_tensor([1.0, 0.5]) * 9.81 * state.position[..., 2]
    energy = solution.energy.kinetic + height.sum(-1)
    for k, joint in enumerate(scene.joints):
        memory = state.joints[:, k, 12:][:, : joint.hysteresis.memory]
        energy = energy + joint.hysteresis.stored(state.joints[:, k, 0], memory) + memory[:, 1]
    assert (state.joints[-1, :, 13] > 0.01).all()
    assert_close(energy, energy[:1].expand_as(energy), rtol=0, atol=1e-11)


def arms(numbers, plane=None):
    """Two arms and a weight on a slider, whose joints yield in their fall; numbers (..., 8)."""
    k, M, H, share, r, n, beta, gamma = numbers.unbind(-1)
    parts = {
        "upper": tb.Beam.straight(0.5, 2, SECTION),
        "lower": tb.Beam.straight(0.5, 2, SECTION, root=(0.5, 0, 0)),
        "weight": tb.Body(mass=0.1, inertia=1e-3, position=(1.0, 0, 0)),
    }
    elbow = tb.ElastoPlastic(k, M, hardening=H, kinematic=share)
    law = tb.BoucWen(k, M / 2, ratio=r, n=n, beta=beta, gamma=gamma)
    joints = [
        tb.Hinge(("upper", -1), ("lower", 0), hysteresis=law),
        tb.Slider(("lower", -1), "weight", axis=(1, 0, 0), hysteresis=tb.ElastoPlastic(k, M)),
    ]
    shoulder = tb.Hinge(None, ("upper", 0), hysteresis=elbow)
    return tb.Scene(parts, [G], joints=[shoulder, *joints], plane=plane)


NUMBERS = torch.tensor(
    [[20.0, 0.6, 2.0, 0.6, 0.1, 1.5, 0.6, 0.3], [15.0, 0.05, 1.0, 0.3, 0.2, 2.0, 0.5, 0.4]],
    dtype=torch.float64,
)


def fallen(numbers, engine="compiled", steps=8):
    stepper = tb.Stepper(arms(numbers), 0.01, engine=engine, tolerance=1e-13)
    state = stepper.rest()
    for _ in range(steps):
        state = stepper(state)
    assert (state.status == 0).all()
    return state


def reading(state):
    return state.position[..., -1, :].sum(-1) + state.joints[..., 12:].sum((-1, -2))


@pytest.fixture(scope="module")
def by_engine():
    answers = {}
    for engine in ("eager", "compiled"):
        numbers = NUMBERS.clone().requires_grad_()
        state = fallen(numbers, engine)
        (slope,) = torch.autograd.grad(reading(state).sum(), numbers)
        answers[engine] = state.detach(), slope
    return answers


def test_both_engines_agree_through_yield(by_engine):
    (eager, slope), (native, native_slope) = by_engine.values()
    for name in ("position", "joints", "work", "stress"):
        assert_close(getattr(native, name), getattr(eager, name), rtol=1e-10, atol=1e-11)
    assert_close(native_slope, slope, rtol=1e-8, atol=1e-10)
    plastic, lost = eager.joints[:, 0, 12], eager.joints[..., 13]
    assert plastic[0] == 0 and plastic[1].abs() > 0.01  # they yield at different times
    assert (lost >= 0).all() and (lost[:, 1] > 1e-6).all()


def test_gradients_against_differences(by_engine):
    """By all numbers of the laws, in samples that yield and that do not."""
    _, slope = by_engine["compiled"]
    h = 1e-5 * NUMBERS
    for k in range(NUMBERS.shape[-1]):
        shift = h * torch.eye(NUMBERS.shape[-1], dtype=torch.float64)[k]
        change = reading(fallen(NUMBERS + shift)) - reading(fallen(NUMBERS - shift))
        assert_close(slope[:, k], change / (2 * h[:, k]), rtol=2e-5, atol=1e-8)


def test_a_sample_alone_is_the_one_in_a_batch(by_engine):
    together, _ = by_engine["compiled"]
    alone = fallen(NUMBERS[1])
    assert_close(together.joints[1], alone.joints, rtol=0, atol=1e-12)


def test_forces_and_energy_of_arms_that_yield(by_engine):
    """The moment of the shoulder about its axis is that of its law; the loss is no larger than what
    gravity has done.
    """
    state, _ = by_engine["eager"]
    limit = NUMBERS[:, 1] + NUMBERS[:, 2] * state.joints[:, 0, 12].abs()
    assert (state.joint[0].moment[:, 1].abs() <= limit + 1e-9).all()
    assert (tb.sensors.JointHysteresis(0)(state) == state.joint[0].memory).all()
    assert (state.joints[..., 13].sum(-1) < -0.5 * 9.81 * state.position[..., -1, 2]).all()


def test_in_single_precision_and_in_a_plane(by_engine):
    state, _ = by_engine["eager"]
    flat = arms(NUMBERS, plane="xz")
    stepper = tb.Stepper(flat, 0.01, engine="eager", tolerance=1e-13)
    other = stepper.rest()
    for _ in range(8):
        other = stepper(other)
    assert_close(other.joints, state.joints, rtol=1e-8, atol=1e-9)
    single = arms(NUMBERS[0]).to(torch.float32)
    stepper = tb.Stepper(single, 0.01, engine="eager")
    assert stepper(stepper.rest()).joints.dtype == torch.float32


# Statics: rigid enough a beam, so that the hinge alone bends


def cantilever(law, force, **more):
    stiff = tb.Section.from_stiffness(EA=1e9, GA=1e9, GJ=1e6, EI=1e6, mass=1.0, inertia=1e-3)
    beam = tb.Beam.straight(2.0, 2, stiff)
    joint = tb.Hinge(None, ("beam", 0), hysteresis=law)
    return tb.Scene({"beam": beam}, [tb.PointLoad(("beam", -1), force=force)], joints=[joint],
                    plane="xz", **more)  # fmt: skip


def height(state):
    return state.position[..., -1, 2]


@pytest.mark.parametrize(
    "law", [tb.ElastoPlastic(1e4, 10.0), tb.BoucWen(1e4, 10.0, n=3.0)], ids=["plastic", "Bouc-Wen"]
)
def test_the_limit_load_of_a_cantilever(law):
    """P = M_p/x, x of the tip: a path by the tip's height goes on at this load; the Bouc-Wen law
    comes within 1e-3 of it at ten times the yield angle.
    """
    path = tb.path(cantilever(law, (0, 0, 1.0)), 10.0, control=height, target=0.02, step=0.1)
    q = path.state.joint[0].coordinate
    assert path.reached and q[-1].abs() > 9e-3
    exact = (10.0 / path.state["beam"].tip.position[..., 0])[-3:]
    rtol = 1e-9 if isinstance(law, tb.ElastoPlastic) else 1e-3
    assert_close(path.factor[-3:], exact, rtol=rtol, atol=0)
    lost = path.state.joint[0].memory[:, 1]
    assert (lost.diff() >= 0).all()


def test_beyond_the_limit_load_there_is_no_equilibrium():
    with pytest.raises(RuntimeError, match="no equilibrium"):
        tb.equilibrium(cantilever(tb.ElastoPlastic(1e4, 10.0), (0, 0, 5.5)))


def test_a_hinge_that_hardens_is_left_bent():
    """Loaded to M = P x, x of the tip: p = (M - M_y)/H; unloaded it keeps p;
    loaded the other way it yields at M = -(M_y - (M - M_y)), by kinematic hardening. Modes of the
    yielded cantilever are elastic.
    """
    law = tb.ElastoPlastic(1e4, 10.0, hardening=2e3)
    scene = cantilever(law, tb.Input("force", 3))

    def under(force, before=None):
        inputs = {"force": torch.tensor([0.0, 0, force], dtype=torch.float64)}
        return tb.equilibrium(scene, initial=before, inputs=inputs), inputs

    loaded, inputs = under(6.0)
    p, lost = loaded.joint[0].memory
    M = 6.0 * loaded["beam"].tip.position[0]
    assert p.item() == pytest.approx(-(M.item() - 10.0) / 2e3, rel=1e-8)
    assert lost.item() == pytest.approx(10.0 * abs(p.item()), rel=1e-12)
    again, _ = under(6.0, loaded)
    assert_close(again.joints, loaded.joints, rtol=1e-9, atol=1e-12)
    free, _ = under(0.0, loaded)
    assert_close(free.joint[0].memory, loaded.joint[0].memory, rtol=0, atol=0)
    assert free.joint[0].coordinate.item() == pytest.approx(p.item(), rel=1e-8)
    for force, yields in ((-3.9, False), (-4.1, True)):
        other, _ = under(force, free)
        assert (other.joint[0].memory[1] > lost) == yields
    elastic = tb.modes(scene, inputs={"force": torch.zeros(3)}, count=2).frequency
    bent = tb.modes(scene, state=loaded, inputs=inputs, count=2).frequency
    assert_close(bent, elastic, rtol=1e-5, atol=0)
    model = tb.linearize(scene, loaded, inputs=inputs)
    speeds = torch.linalg.eigvals(model.A).imag.abs().sort().values
    assert_close(speeds[:2], elastic[:1].expand(2), rtol=1e-5, atol=0)


def test_an_equilibrium_has_derivatives_by_the_law_and_by_the_past():
    numbers = torch.tensor([1e4, 10.0, 2e3], dtype=torch.float64)

    def bent(numbers):
        law = tb.ElastoPlastic(*numbers.unbind(-1)[:2], hardening=numbers[..., 2])
        scene = cantilever(law, tb.Input("force", 3))
        up = tb.equilibrium(scene, inputs={"force": (0, 0, 6.0)})
        return height(tb.equilibrium(scene, initial=up, inputs={"force": (0, 0, 1.0)}))

    own = numbers.clone().requires_grad_()
    (slope,) = torch.autograd.grad(bent(own), own)
    for k in range(3):
        shift = 1e-4 * numbers * torch.eye(3, dtype=torch.float64)[k]
        change = bent(numbers + shift) - bent(numbers - shift)
        assert_close(slope[k], change / (2 * shift[k]), rtol=1e-5, atol=1e-12)


def test_a_state_of_another_law_is_taken(tmp_path):
    state = fallen(NUMBERS[0], steps=1)
    tb.save(state, tmp_path / "state.pt")
    again = tb.load(tmp_path / "state.pt")
    assert_close(again.joints, state.joints, rtol=0, atol=0)
    plain = replace(state, joints=state.joints[..., :12])
    stepper = tb.Stepper(arms(NUMBERS[0]), 0.01, engine="eager")
    assert stepper(plain).joints.shape == state.joints.shape
    with pytest.raises(ValueError, match="no law with memory"):
        tb.sensors.JointHysteresis(0)(plain)


@pytest.mark.parametrize("engine", ["compiled", "eager"])
def test_a_run_from_a_saved_state_is_the_rest_of_one_run(engine, tmp_path):
    """Joints that yield between beams that relax: what both remember is in the file; to the bit."""
    scene = arms(NUMBERS)
    relaxing = [tb.Viscoelastic((0.3,), (0.02,), on=name) for name in ("upper", "lower")]
    scene = replace(scene, effects=(*scene.effects, *relaxing))
    t = torch.linspace(0, 0.12, 3, dtype=torch.float64)
    whole = tb.simulate(scene, t, step=0.01, engine=engine).state
    tb.save(whole[1], tmp_path / "half.pt")
    half = tb.load(tmp_path / "half.pt")
    end = tb.simulate(scene, t[1:], step=0.01, initial=half, engine=engine).state[-1]
    for name in ("position", "joints", "stress", "inelastic"):
        assert torch.equal(getattr(end, name), getattr(whole[-1], name)), name
    assert (end.joints[1, 0, 12:14] != half.joints[1, 0, 12:14]).all()


@pytest.mark.parametrize("method", ["midpoint4", "generalized_alpha", "dopri5"])
def test_other_methods_refuse_it(method):
    with pytest.raises(ValueError, match="'midpoint' takes it"):
        tb.simulate(arms(NUMBERS[0]), [0.0, 0.01], method=method)


# Drives


def test_a_drive_of_angle_and_rate_is_spring_and_damper():
    """In steps of both engines, with gradients; at rest; in modes, whose damping it has. Over a
    step a damper takes c D/dt, and the drive c (q' - q)/dt: they differ by the square of a turn.
    """
    k = torch.tensor([0.5, 1.0], dtype=torch.float64, requires_grad=True)

    def scene(**law):
        arm = {"arm": tb.Beam.straight(0.5, 2, SECTION)}
        return tb.Scene(arm, [G], joints=[tb.Hinge(None, ("arm", 0), **law)])

    law = tb.Drive(lambda angle, rate, k: -k * angle - 0.05 * rate, values={"k": k})
    known, own = scene(stiffness=k, damping=0.05), scene(torque=law)
    moved = []
    for made, engine in ((known, "compiled"), (own, "compiled"), (own, "eager")):
        state = tb.simulate(made, [0.0, 0.005, 0.01], step=0.005, engine=engine).state[-1]
        (slope,) = torch.autograd.grad(state.joints[:, 0, 0].sum(), k, retain_graph=True)
        moved.append((state.joints.detach(), slope))
    for joints, slope in moved[1:]:
        assert_close(joints, moved[0][0], rtol=1e-5, atol=1e-8)
        assert_close(slope, moved[0][1], rtol=1e-5, atol=1e-12)
    assert_close(moved[1][0], moved[2][0], rtol=0, atol=1e-11)
    known, own = (x.to(torch.float64) for x in (known, own))
    rests = [tb.equilibrium(x).joints.detach() for x in (known, own)]
    assert_close(*rests, rtol=1e-8, atol=1e-9)
    values = [tb.modes(x, count=2).eigenvalue.detach() for x in (known, own)]
    assert_close(*values, rtol=1e-9, atol=1e-9)


def test_a_generator_comes_to_the_speed_that_balances_it():
    """J w' = T - c w^2, from rest: w = sqrt(T/c) tanh(sqrt(T c) t/J); time and all by names."""
    c = torch.tensor([0.1, 0.4], dtype=torch.float64)
    law = tb.Drive(lambda rate, t, c: 2.0 - c * rate**2 + 0 * t, values={"c": c})
    scene = wheel(torque=law)
    rates = [turned(scene, step, 0.4).joint[0].rate[-1] for step in (0.04, 0.02)]
    exact = torch.sqrt(2 / c) * torch.tanh(torch.sqrt(2 * c) * 0.4 / INERTIA)
    errors = [(rate - exact).abs() for rate in rates]
    assert (errors[1] < 2e-3).all() and (errors[0] / errors[1] > 3.5).all()


def test_a_drive_that_mixes_samples_is_refused():
    c = torch.tensor([0.1, 0.4], dtype=torch.float64)
    law = tb.Drive(lambda rate, c: -c * (rate + 0.1 * rate.mean()), values={"c": c})
    with pytest.raises(ValueError, match="mixes the samples"):
        tb.simulate(wheel(torque=law), [0.0, 0.1], step=0.1, engine="compiled")


@refusals(
    (lambda: tb.Drive(lambda a: a), "function of a was given"),
    (lambda: tb.Drive(3.0), "angle or travel, or rate, is wanted"),
    (lambda: tb.Drive(lambda angle: angle, values={"k": 1.0}), "the value 'k' was given"),
    (lambda: tb.Hinge(None, "hub", torque=lambda travel: travel), "angle, rate or t is wanted"),
    (lambda: tb.Slider(None, "hub", force=lambda angle: angle), "travel, rate or t is wanted"),
    (lambda: tb.Hinge(None, "hub", torque=lambda rate, load: load), "'load'"),
    (lambda: turned(wheel(torque=lambda rate: (rate, rate)), 0.1), "shape"),
)
def test_drives_that_do_not_fit_are_refused(make):
    make()
