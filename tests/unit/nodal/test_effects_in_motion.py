"""Every effect on a whole beam in motion: everything turned gives the turned answer, energy grows
by the power of what acts, and the mixed and the nodal form tend to one motion.
"""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.nodal_cases import spd
from torchbeam.extend import quaternions as quat
from torchbeam.nodal.constitutive_law import times
from torchbeam.nodal.loads import external
from torchbeam.nodal.rates import Rates

N = 3
T = torch.tensor(0.3)


def section(offset=(0.0, 0.05, -0.03)):
    """Stiffnesses of one size, each coupled to every other; the centre of mass off the axis."""
    torch.manual_seed(2)
    K, e = 8 * spd(), quat.skew(torch.tensor(offset))
    J = torch.diag(torch.tensor([0.06, 0.03, 0.04])) + e.mT @ e
    return tb.Section(
        torch.linalg.inv(K), torch.cat((torch.cat((torch.eye(3), -e), -1), torch.cat((e, J), -1)))
    )


COUPLED, CENTRED = section(), section((0.0, 0.0, 0.0))


def wave(t):
    return torch.stack((torch.sin(2 * t), torch.cos(3 * t), 1 + t))


def along(s, t):
    return torch.stack((s, s * t, 1 - s), -1)


def stream(x, t):
    return torch.stack((x[..., 1], x[..., 0] * x[..., 2], x[..., 0] + t), -1)


def pull(x, v):
    return torch.stack((-x[..., 0], x[..., 0] * v[..., 2], v[..., 1]), -1)


class Turned:
    """What is written in frame a, turned by Q."""

    def __init__(self, Q):
        self.Q = Q

    def __call__(self, v):
        return (self.Q @ torch.as_tensor(v)[..., None])[..., 0]

    def of(self, function):
        return lambda *x: self(function(*x))

    def field(self, function):
        """Of a function of a vector and more."""
        back = Turned(self.Q.mT)
        return lambda x, *more: self(function(back(x), *more))


def user(turn):
    back = Turned(turn.Q.mT)
    return tb.Load(
        lambda r, R, v, w, t: (
            turn(pull(back(r), back(v))) + R[..., 2] * t,
            torch.linalg.cross(w, r) - 0.3 * w,
        ),
        node=None,
    )


def lagging(turn):
    return tb.Load(
        lambda r, R, v, w, t, z: (z * v, R[..., 0] * z),
        node=-1,
        internal=1,
        of=("position", "rotation", "velocity"),
        rate=lambda z, r, R, v, w, t: (v * v).sum(-1, keepdim=True) - 3 * z,
    )


def with_effects(*makers):
    return lambda turn: dict(effects=[make(turn) for make in makers])


# fmt: off
CASES = {
    "dead load": with_effects(lambda q: tb.TipLoad(force=q.of(wave), moment=q((0.2, -0.1, 0.3)))),
    "follower load": with_effects(lambda q: tb.PointLoad(force=(0.5, 1.0, 2.0), moment=wave, node=2,
                                                         follower=True)),
    "line load of s": with_effects(lambda q: tb.LineLoad(force=tb.Along(q.of(along)),
                                                         moment=q((0.1, 0.2, 0.1)))),
    "gravity": with_effects(lambda q: tb.Gravity(q((1.0, -2.0, -9.81)))),
    "mass damping": with_effects(lambda q: tb.MassDamping(0.7)),
    "drag": with_effects(lambda q: tb.Drag(20.0, 0.2, tangential=0.1, flow=q((0.5, -0.3, 1.0)))),
    "drag in a flow": with_effects(lambda q: tb.Drag(20.0, 0.2, tangential=0.1,
                                                     flow=q.field(stream))),
    "added mass": with_effects(lambda q: tb.Drag(2.0, 0.5, added_mass=1.0)),
    "added mass in a frame": lambda q: dict(effects=[tb.Drag(2.0, 0.5, added_mass=1.0)],
                                            frame=tb.Frame(velocity=q((0.3, -0.2, 0.5)),
                                                           angular_velocity=q.of(wave))),
    "spring": with_effects(lambda q: tb.Spring(-1, 20.0, to=q((0.8, 0.3, 0.5)), length=0.2,
                                               damping=0.5)),
    "root spring": with_effects(lambda q: tb.RootSpring((torch.tensor([50.0, 60, 70]),
                                                         torch.tensor([5.0, 6, 7])), (1.0, 0.1))),
    "point mass": with_effects(lambda q: tb.PointMass(0.4, inertia=(0.02, 0.03, 0.04),
                                                      offset=(0.1, -0.2, 0.1), node=2),
                               lambda q: tb.Gravity(q((1.0, -2.0, -9.81)))),
    "actuation": with_effects(lambda q: tb.Actuation(curvature=(0.5, 1.0, -0.7),
                                                     strain=(0.05, 0.02, 0.0))),
    "user load": with_effects(user),
    "lagging load": with_effects(lagging),
    "frame": lambda q: dict(effects=[tb.Gravity(q((1.0, -2.0, -9.81)))],
                            frame=tb.Frame(velocity=q((0.3, -0.2, 0.5)),
                                           angular_velocity=q.of(wave))),
    "root motion": lambda q: dict(root=tb.RootMotion(displacement=q.of(lambda t: 0.1 * wave(t)),
                                                     rotation=q.of(lambda t: 0.3 * wave(t)))),
    "free": lambda q: dict(effects=[tb.Gravity(q((1.0, -2.0, -9.81)))], supports=()),
    "propped": lambda q: dict(effects=[tb.Gravity(q((1.0, -2.0, -9.81)))], supports=(
        tb.Support(0),
        tb.Support(-1, rotation="", displacement=q.of(lambda t: 0.1 * (wave(t) - wave(0 * t)))))),
    "damping": with_effects(lambda q: tb.Damping((0.01, 0.02, 0.03, 0.04, 0.05, 0.06))),
}
# fmt: on


def case(name, turn):
    placed = dict(
        direction=turn((1.0, 0.2, 0.1)), up=turn((0.0, 0.3, 1.0)), root=turn((0.2, 0.1, -0.1))
    )
    beam = tb.Beam.straight(1.0, N, CENTRED if "added mass" in name else COUPLED, **placed)
    more = CASES[name](turn)
    effects = [tb.TipLoad(force=turn((0.5, 3.0, 2.0))), *more.pop("effects", ())]
    return tb.Scene(beam, effects, **more)


def turns():
    torch.manual_seed(5)
    return Turned(torch.eye(3)), Turned(quat.matrix(quat.normalize(torch.randn(4))))


def moved(scene):
    """A state of large motion: five implicit steps of 20 ms, converged to rounding."""
    stepper = tb.Stepper(scene, 0.02, tolerance=1e-13)
    state = stepper.rest()
    for _ in range(5):
        state = stepper(state)
    assert state.status == 0
    return state


# the random scenes of test_metamorphic.py, which it turns, have these; or another case here has
# them, and more
HELD = {
    "dead load", "line load of s", "gravity", "mass damping", "drag", "added mass", "spring",
    "point mass", "user load", "frame", "free", "damping",
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.long] * (name in HELD)) for name in CASES]
)
def test_everything_turned_is_the_motion_turned(name):
    """Implicit steps, the accelerations of the explicit form at their end, and, where it takes the
    scene, the minimal form's motion. 1e-9: rounding, times the condition of a step.
    """
    one, Q = turns()
    scenes = [case(name, turn) for turn in (one, Q)]
    here, there = map(moved, scenes)
    pairs = {key: (Q(getattr(here, key)), getattr(there, key)) for key in ("position", "velocity")}
    pairs["rotation"] = Q.Q @ quat.matrix(here.rotation), quat.matrix(there.rotation)
    pairs |= {key: (getattr(here, key), getattr(there, key)) for key in ("spin", "stress", "work")}
    pairs["reaction"] = Q(here.reaction.unflatten(-1, (2, 3))), there.reaction.unflatten(-1, (2, 3))
    if here.internal is not None:
        pairs["internal"] = here.internal, there.internal
    if name != "propped":  # a support that moves at the tip: the implicit step alone takes it
        (v0, w0), (v1, w1) = (
            acceleration(scene, state) for scene, state in zip(scenes, (here, there), strict=True)
        )
        pairs |= {"acceleration": (Q(v0), v1), "spin rate": (w0, w1)}
    if "minimal" not in tb.describe(scenes[0]).refusals:
        a, b = (
            tb.simulate(
                scene, [0.0, 2e-3], form="minimal", method="rk4", options={"step_size": 1e-3}
            ).state[-1]
            for scene in scenes
        )
        pairs |= {
            "minimal form": (Q(a.position), b.position),
            "its velocity": (Q(a.velocity), b.velocity),
        }
    assert (there.position - here.position).abs().max() > 0.1 and here.velocity.abs().max() > 0.1
    for key, (expected, found) in pairs.items():
        assert_close(
            found,
            expected,
            rtol=0,
            atol=1e-9 * max(1.0, expected.abs().max().item()) if expected.numel() else 0,
            msg=lambda text, key=key: f"{key}: {text}",
        )


def acceleration(scene, state):
    rates = Rates.of(scene, {})
    nodes, spin, _ = rates.unpack(T, rates.pack(state))
    return rates.accelerations(
        rates.conditions(T), nodes, spin, rates.balance(rates.conditions(T), nodes)[0]
    )


@pytest.mark.parametrize("name", [name for name in CASES if name != "propped"])
def test_energy_grows_by_the_power_of_what_acts(name):
    """d/dt (kinetic + strain energy) along the explicit rates, by forward mode, is force times
    velocity plus moment times spin of all loads, plus that of a clamp that moves, less sum(length
    strain rate^T D strain rate) of damping. To rounding (1e-10 of the largest power), with a moving
    clamp to 1e-5, for its momentum's rate is a difference over 0.2 ms.
    """
    scene = case(name, turns()[1])
    state = moved(scene)
    rates = Rates.of(scene, {})
    model, space = rates.model, rates.model.space
    y = rates.pack(state)
    own = model.eigenstrain(T, {})

    def energies(t, y):
        nodes, spin, _ = rates.unpack(t, y)
        kin = model.kinematics(nodes.position, nodes.rotation)
        return (
            model.kinetic_energy(nodes.position, nodes.rotation, nodes.velocity, spin)
            + model.strain_energy(nodes.position, nodes.rotation, own),
            space.strains(kin, model.length),
        )

    y_rate = rates(T, y)
    _, (gained, strain_rate) = torch.func.jvp(energies, (T, y), (torch.ones_like(T), y_rate))
    nodes = rates.unpack(T, y)[0]
    now = rates.conditions(T)
    net, _ = rates.balance(now, nodes)
    found, frame = rates.accelerations(now, nodes, rates.unpack(T, y)[1], net)[0], model.frame(T)
    if nodes.acceleration is not None:  # what an added mass is multiplied by, of free nodes too
        if frame.turns:
            found = found + torch.linalg.cross(
                *torch.broadcast_tensors(frame.omega, nodes.velocity[1:])
            )
        nodes = nodes._replace(acceleration=torch.cat((nodes.acceleration[:1], found)))
    loads = external(model, nodes, now)
    motion = torch.cat((nodes.velocity, nodes.spin), -1)
    each = (loads * motion).sum(-1)
    power = each.sum()
    if scene.has_prescribed_motion:
        power = (
            power
            + (
                rates.reaction(now, nodes, rates.unpack(T, y)[1], net)[..., 0, :]
                * motion[..., 0, :]
            ).sum()
        )
    if model.law.damped:
        stress = times(model.law.C, times(model.law.retardation_time, strain_rate[..., None]))[
            ..., 0
        ]
        lost = (model.length * strain_rate * stress).sum()
        assert lost > 1e-3 * each.abs().max()
        power = power - lost
    close = 1e-5 if scene.has_prescribed_motion else 1e-10
    assert each.abs().max() > 0.1
    assert_close(
        gained, power, rtol=0, atol=close * max(each.abs().max().item(), gained.abs().item())
    )


# fmt: off
FORMS = {  # on (..., 1): 1 where the sample has the effect, else 0
    "gravity": lambda on: dict(effects=[tb.Gravity(on * torch.tensor([1.0, -2.0, -9.81]))]),
    "follower load": lambda on: dict(effects=[tb.PointLoad(
        force=on * torch.tensor([0.5, 1.0, 2.0]), moment=lambda t: on * wave(t), node=2,
        follower=True)]),
    "damping": lambda on: dict(effects=[tb.Damping(on * torch.tensor([0.0, 0, 0, 0, 0.08, 0.08]),
                                                   six=True)]),
    "frame that turns": lambda on:
    dict(frame=tb.Frame(angular_velocity=lambda t: 3 * on * wave(t))),
    "frame that accelerates": lambda on:
    dict(frame=tb.Frame(velocity=lambda t: 3 * t * t * on * wave(t))),
    "root motion": lambda on: dict(root=tb.RootMotion(*(lambda t: t * t * on * wave(t),) * 2)),
}
# fmt: on


ALONE = "frame that turns", "damping"  # the one takes no weight beside it, the other small steps


@pytest.mark.parametrize(
    "names",
    [*((name,) for name in ALONE), tuple(name for name in FORMS if name not in ALONE)],
    ids=[*ALONE, "others"],
)
def test_the_mixed_and_the_nodal_form_tend_to_one_motion(names):
    """Tips at t = 0.4 from rest under a load that grows, N = 2 and 4: their distance falls by more
    than 2.5 (4 in the limit of fine meshes), to less than what the effect does. One effect a
    sample, the last has none. Other effects: verification/test_effects.py. The minimal form is the
    block rate form to rounding, see unit/mixed/test_rates.py.
    """
    t, apart, more = torch.tensor([0.0, 0.4]), [], {}
    effects = [tb.TipLoad(force=lambda t: 20 * t * t * torch.tensor([0.5, 1.0, 2.0]))]
    for on, name in zip(torch.eye(len(names) + 1), names, strict=False):
        given = FORMS[name](on[:, None])
        effects += given.pop("effects", [])
        more |= given
    of = tb.Section.from_stiffness(EA=60.0, GA=40.0, GJ=0.8, EI=1.0, mass=1.0, inertia=0.05)
    for n in (2, 4):
        scene = tb.Scene(tb.Beam.straight(1.0, n, of), effects, **more)
        mixed = tb.simulate(scene, t, form="minimal", rtol=1e-3, atol=1e-4).tip.position[-1]
        nodal = tb.simulate(scene, t, step=0.01).tip.position[-1]
        apart.append((nodal - mixed).norm(dim=-1))
    does = (nodal - nodal[-1]).norm(dim=-1)
    for k, name in enumerate(names):
        assert apart[1][k] < does[k] and apart[0][k] > 2.5 * apart[1][k], (name, apart)
