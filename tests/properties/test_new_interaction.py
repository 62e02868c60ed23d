"""A new interaction is one class: native code, gradients, equilibria, paths, modes, batches, save
and load follow from its wrench, or from the residual of its unknowns, and from what it remembers.
These are written here, and no list anywhere knows them.
"""

import copy
import io
import math
import pickle
from dataclasses import dataclass, replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam.extend import (
    ACCELERATION,
    POSITION,
    ROTATION,
    SPIN,
    VELOCITY,
    Interaction,
    LoadPoint,
    Value,
    detached,
    leaf,
    leaves,
)

SECTION = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-3)
G = (0.0, -9.81, 0.0)


@dataclass(frozen=True)
class Gear(Interaction):
    """Two nodes that turn about z are geared by teeth of some stiffness: the moment of the first is
    stiffness (ratio a + b), of the angles a and b that they have turned by, the second's ratio-th.
    """

    stiffness: Value = leaf(0, nonnegative=True)  # N m/rad
    ratio: Value = leaf(0, default=1.0)

    depends = frozenset({ROTATION})
    conservative = True

    def wrench(self, point, t, inputs):
        first, second = torch.atan2(point.R[..., 1, 0], point.R[..., 0, 0]).unbind(-1)
        teeth = -self.stiffness * (self.ratio * first + second)
        about = torch.stack((self.ratio * teeth, teeth), -1)
        return None, torch.stack((0 * about, 0 * about, about), -1)


@dataclass(frozen=True)
class Bracing(Interaction):
    """A spring and a damper between three nodes, against the second's leaving of the middle of the
    others, and against its turning beside them.
    """

    stiffness: Value = leaf(0, positive=True)  # N/m
    damping: Value = leaf(0, default=0.05)  # N s/m, and N m s

    depends = frozenset({POSITION, VELOCITY, SPIN})

    def wrench(self, point, t, inputs):
        shares = point.position.new_tensor([[0.5], [-1.0], [0.5]])
        away, rate = ((shares * x).sum(-2, keepdim=True) for x in (point.position, point.velocity))
        stiffness, damping = self.stiffness[..., None, None], self.damping[..., None, None]
        turning = (shares * point.spin).sum(-2, keepdim=True)
        return -shares * (stiffness * away + damping * rate), -shares * damping * turning


@dataclass(frozen=True)
class Tie(Interaction):
    """A linear spring between two nodes."""

    stiffness: Value = leaf(0)  # N/m

    depends = frozenset({POSITION})
    conservative = True

    def wrench(self, point, t, inputs):
        pull = self.stiffness[..., None, None] * point.position.diff(dim=-2)
        return torch.cat((pull, -pull), -2), None


@dataclass(frozen=True)
class Link(Interaction):
    """Two nodes keep their distance."""

    length: Value = leaf(0, positive=True)  # m

    unknowns = 1
    depends = frozenset({POSITION})
    conservative = True

    def residual(self, point, t, inputs):
        apart = torch.linalg.vector_norm(point.position.diff(dim=-2), dim=-1)
        return apart - self.length[..., None]


@dataclass(frozen=True)
class Rack(Interaction):
    """The second node moves along x by radius times the angle about z by which the first turns. It
    remembers how far it has gone, whichever way.
    """

    radius: Value = leaf(0, positive=True)  # m

    unknowns, memory = 1, 2
    depends = frozenset({POSITION, ROTATION})
    conservative = True

    def residual(self, point, t, inputs):
        angle = torch.atan2(point.R[..., 0, 1, 0], point.R[..., 0, 0, 0])
        return (point.position[..., 1, 0] - self.radius * angle)[..., None]

    def remember(self, point, t, inputs):
        place, (last, way) = point.position[..., 1, 0], point.internal.unbind(-1)
        return torch.stack((place, way + (place - last).abs()), -1)


@dataclass(frozen=True)
class Gears(Interaction):
    """Two wheels that turn about z, which remember their angles over all turns."""

    ratio: Value = leaf(0)

    unknowns, memory = 1, 2
    depends = frozenset({ROTATION})

    def remember(self, point, t, inputs):
        last = point.internal
        cos, sin = last.cos(), last.sin()
        x, y = point.R[..., 0, 0], point.R[..., 1, 0]
        return last + torch.atan2(cos * y - sin * x, cos * x + sin * y)

    def residual(self, point, t, inputs):
        driver, driven = self.remember(point, t, inputs).unbind(-1)
        return (driven + self.ratio * driver)[..., None]


@dataclass(frozen=True)
class Between(Interaction):
    """The second of three nodes is in the middle of the others, but for a yielding by its force."""

    yielding: Value = leaf(0, nonnegative=True)  # m/N

    unknowns = 3
    depends = frozenset({POSITION})
    conservative = True

    def residual(self, point, t, inputs):
        a, b, c = point.position.unbind(-2)
        return b - (a + c) / 2 - self.yielding[..., None] * point.own


@dataclass(frozen=True)
class Mainspring(Interaction):
    """A spring about z that is wound up by any number of turns, and wears as it is."""

    stiffness: Value = leaf(0)  # N m/rad

    memory = 2  # rad: how far it is wound up, and how far it has gone
    depends = frozenset({ROTATION})

    def angle(self, point):
        first, second = torch.atan2(point.R[..., 1, 0], point.R[..., 0, 0]).unbind(-1)
        turns = (point.internal[..., 0] - (second - first)) / (2 * math.pi)
        return second - first + 2 * math.pi * torch.round(turns).detach()

    def wrench(self, point, t, inputs):
        moment = self.stiffness * self.angle(point) / (1 + 0.1 * point.internal[..., 1])
        about = torch.stack((moment, -moment), -1)
        return None, torch.stack((0 * about, 0 * about, about), -1)

    def remember(self, point, t, inputs):
        angle, (last, way) = self.angle(point), point.internal.unbind(-1)
        return torch.stack((angle, way + (angle - last).abs()), -1)


def hinged(*effects, joints=(), root=(0.3, 0.4, 0), **more):
    """Two arms that are hinged to the ground, crosswise where the second begins at this root."""
    arms = {
        "left": tb.Beam.straight(0.5, 3, SECTION),
        "right": tb.Beam.straight(0.4, 2, SECTION, root=root),
    }
    hinges = [tb.Hinge(None, (name, 0), axis=(0, 0, 1)) for name in arms]
    return tb.Scene(arms, [tb.Gravity(G), *effects], joints=[*hinges, *joints], **more)


TIPS = ("left", -1), ("right", -1)


def linked(stiffness, **more):
    """Their tips keep their distance, and a spring holds the first."""
    spring = tb.Spring(("left", 2), stiffness, to=(0.3, 0.1, 0.0))
    return hinged(spring, Link(TIPS, 0.2**0.5), **more)


def racked(stiffness, **more):
    """An arm that turns moves a body on a slider, against a spring."""
    arm, body = (
        tb.Beam.straight(0.5, 2, SECTION),
        tb.Body(mass=0.1, inertia=1e-3, position=(0, 0, 0)),
    )
    joints = [tb.Hinge(None, ("arm", 0), axis=(0, 0, 1)), tb.Slider(None, "body", axis=(1, 0, 0))]
    spring = tb.Spring("body", stiffness, to=(0.0, 0, 0))
    effects = [tb.Gravity(G), spring, Rack((("arm", 0), "body"), 0.1)]
    return tb.Scene({"arm": arm, "body": body}, effects, joints=joints, **more)


def halved(stiffness, **more):
    """Nodes of a cantilever whose middle yields, beside a link."""
    beam, middle = tb.Beam.straight(1.0, 4, SECTION), Between((1, 2, 4), 1e-2 / stiffness)
    return tb.Scene(beam, [tb.Gravity(G), middle, Link((0, 3), 0.75)], **more)


def wound(stiffness, **more):
    """Two bodies that turn against each other, by more than a turn."""
    places = {"first": 0.0, "second": 1.0}
    bodies = {n: tb.Body(mass=1.0, inertia=5e-3, position=(x, 0, 0)) for n, x in places.items()}
    joints = [tb.Hinge(None, name, axis=(0, 0, 1)) for name in bodies]
    moment = tb.PointLoad("second", moment=(0, 0, 1.0))
    spring = Mainspring(("first", "second"), 0.01 * stiffness)
    return tb.Scene(bodies, [spring, moment], joints=joints, **more)


def linkage(stiffness, ratio=0.5, **more):
    """Two arms, hinged to the ground, whose hubs are geared."""
    gear = Gear((("left", 0), ("right", 0)), stiffness, ratio)
    return hinged(tb.MassDamping(0.2), gear, root=(1.0, 0, 0), **more)


def braced(stiffness, damping=0.05, plane=None, small=False, **more):
    """A cantilever whose tip, middle and another node are braced."""
    load = tb.TipLoad(force=(0.0, 0.1, 0.0 if plane else 0.4))
    effects = [tb.Gravity(G), load, Bracing((-1, 2, 1), stiffness, damping)]
    beam = tb.Beam.straight(1.0, 4, SECTION)
    return tb.Scene(beam, effects, plane=plane, small=small, **more)


SCENES = {
    "gear": linkage, "gear in a plane": lambda k: linkage(k, plane="xy"), "braced": braced,
    "braced in a plane": lambda k: braced(k, plane="xy"),
    "braced, small": lambda k: braced(k, small=True),
    "linked in a plane": lambda k: linked(k, plane="xy"), "racked": racked, "halved": halved,
    "wound in a plane": lambda k: wound(k, plane="xy"),
}  # fmt: skip


def moved(scene, engine, method="midpoint", steps=3):
    stepper = tb.Stepper(scene, 0.02, method=method, engine=engine, tolerance=1e-13)
    state = stepper.rest()
    for _ in range(steps):
        state = stepper(state)
    assert (state.status == 0).all()
    return state


@pytest.mark.parametrize("method", ["midpoint", "generalized_alpha"])
@pytest.mark.parametrize("name", SCENES)
def test_native_steps_and_gradients_are_the_eager_ones(name, method):
    found = {}
    for engine in ("eager", "compiled"):
        stiffness = torch.tensor([2.0, 5.0], dtype=torch.float64, requires_grad=True)
        state = moved(SCENES[name](stiffness), engine, method)
        memory = torch.zeros(()) if state.memory is None else state.memory
        asked = state.position.square().sum() + state.work.sum() + memory.square().sum()
        asked = asked + 1e-3 * state.stress.square().sum()  # forces of constraints among them
        (slope,) = torch.autograd.grad(asked, stiffness)
        found[engine] = state.position.detach(), state.work.detach(), memory.detach(), slope
    *states, slope = zip(*found.values(), strict=True)
    for eager, native in states:
        assert_close(native, eager, rtol=0, atol=1e-12)
    assert_close(slope[1], slope[0], rtol=1e-9, atol=1e-12)
    assert (slope[0] != 0).all()


@pytest.mark.parametrize("name", SCENES)
def test_gradients_against_differences(name):
    stiffness = torch.tensor([2.0, 5.0], dtype=torch.float64)

    def height(stiffness):
        state = moved(SCENES[name](stiffness), "auto")
        place = state.position[..., -1, :2].sum(-1)
        return place if state.memory is None else place + state.memory.sum((-1, -2))

    h, own = 1e-5, stiffness.clone().requires_grad_()
    (slope,) = torch.autograd.grad(height(own).sum(), own)
    assert_close(
        slope, (height(stiffness + h) - height(stiffness - h)) / (2 * h), rtol=1e-6, atol=1e-9
    )


@pytest.mark.parametrize("engine", ["eager", "compiled"])
def test_at_a_clamp_it_is_the_spring_to_that_point(engine, monkeypatch):
    """In motion, at rest, along a path, in modes, in the explicit form."""
    monkeypatch.setenv("TORCHBEAM_ENGINE", engine)
    beam, pull = tb.Beam.straight(1.0, 4, SECTION), tb.TipLoad(force=tb.Input("u", 3))
    force = torch.tensor([0.0, 1.0, 0.2], dtype=torch.float64)
    found = []
    for own in (Tie((-1, 0), 3.0), tb.Spring(-1, 3.0, to=(0.0, 0, 0))):
        scene = tb.Scene(beam, [pull, own])
        stepper = tb.Stepper(scene, 0.02, tolerance=1e-13)
        state = stepper.rest()
        for _ in range(3):
            state = stepper(state, u=force)
        rest = tb.equilibrium(scene, inputs={"u": force})
        path = tb.path(scene, load="u", inputs={"u": force}, steps=3)
        modes = tb.modes(scene, state=rest, inputs={"u": force}, count=4)
        found.append((state.position, state.work, rest.position, path.factor, modes.frequency))
    for ours, known in zip(*found, strict=True):
        assert_close(ours, known, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("engine", ["eager", "compiled"])
def test_a_link_is_the_joint_that_keeps_a_distance(engine, monkeypatch):
    """In motion, at rest, along a path, in modes, in a linear model; where its forces are, too."""
    monkeypatch.setenv("TORCHBEAM_ENGINE", engine)
    down, push = torch.tensor([0.0, -1.0, 0.0], dtype=torch.float64), tb.Input("u", 3)
    spring = tb.Spring(("left", 2), 50.0, to=(1 / 3, 0.0, 0.0))
    load, found = tb.PointLoad(("right", -1), push), []
    for own in (dict(effects=[Link(TIPS, 0.2**0.5)]), dict(joints=[tb.Distance(*TIPS)])):
        scene = hinged(spring, load, *own.get("effects", ()), joints=own.get("joints", ()))
        stepper = tb.Stepper(scene, 0.02, tolerance=1e-13)
        state = stepper.rest()
        for _ in range(3):
            state = stepper(state, u=down)
        rest = tb.equilibrium(scene, inputs={"u": down})
        path = tb.path(scene, load="u", inputs={"u": down}, steps=3)
        modes = tb.modes(scene, state=rest, inputs={"u": down}, count=3)
        A = tb.linearize(scene, state=rest, inputs={"u": down}).A
        speeds = torch.linalg.eigvals(A).imag.sort().values
        forces = state.stress[..., :7, :]
        found.append(
            (
                state.position,
                state.work,
                forces,
                rest.position,
                path.factor,
                modes.frequency,
                speeds,
            )
        )
    for ours, known in zip(*found, strict=True):
        assert_close(ours, known, rtol=1e-9, atol=1e-9)


def test_constraints_hold_where_a_step_ends():
    for scene, k in ((racked(20.0), 0), (halved(2.0), 1), (linked(5.0), 0)):
        state, one = moved(scene, "compiled", steps=5), scene.interactions[k]
        nodes = list(one.nodes)
        point = LoadPoint(state.axes[..., nodes, :, :], position=state.position[..., nodes, :])
        assert one.residual(point, state.t, {}).abs().max() < 1e-12


def test_a_memory_counts_turns_and_starts_anew():
    state = moved(wound(0.1), "compiled", steps=30)
    wound_up, way = state.memory[0].tolist()
    assert wound_up > 2 * math.pi and way == pytest.approx(wound_up, abs=1e-9)
    assert state.memory.shape == (1, 2) and (tb.rest(wound(0.1)).memory == 0).all()
    rack = tb.equilibrium(racked(20.0))
    assert_close(rack.memory[0, 0], rack.position[-1, 0], rtol=0, atol=1e-12)
    solution = tb.simulate(racked(20.0), torch.linspace(0, 0.1, 6), step=0.02)
    place = solution.state.position[:, -1, 0]
    assert_close(solution.state.memory[-1, 0, 1], place.diff().abs().sum(), rtol=0, atol=1e-12)


def test_an_equilibrium_goes_on_from_what_is_remembered():
    """From `initial`, and along a path: the rack's way is the sum of all its moves."""
    first = tb.equilibrium(racked(20.0))
    again = tb.equilibrium(racked(40.0), initial=first)
    places = [state.position[-1, 0] for state in (first, again)]
    way = places[0].abs() + (places[1] - places[0]).abs()
    assert_close(again.memory[0, 1], way, rtol=1e-12, atol=0)
    path = tb.path(racked(20.0), step=0.3)
    moves = path.state.position[:, -1, 0].diff().abs()
    assert_close(path.state.memory[-1, 0, 1], moves.sum(), rtol=1e-12, atol=0)


def test_what_has_unknowns_or_a_memory_says_how():
    with pytest.raises(TypeError, match="residual that determines"):
        type("Loose", (Interaction,), dict(unknowns=1))
    with pytest.raises(TypeError, match="with 7 unknowns"):
        type("Many", (Interaction,), dict(unknowns=7, residual=Link.residual))
    with pytest.raises(TypeError, match="`remember` that fills it"):
        type("Empty", (Interaction,), dict(memory=1))
    four = type("Four", (Link,), dict(unknowns=4))
    with pytest.raises(ValueError, match="4 unknowns was given in a plane"):
        tb.Stepper(hinged(four(TIPS, 1.0), plane="xy"), 0.01)
    with pytest.raises(ValueError, match="a Mainspring with unknowns or a memory"):
        beam = tb.Beam.straight(1.0, 2, SECTION)
        tb.simulate(
            tb.Scene(beam, Mainspring((0, 2), 1.0)), torch.tensor([0.0, 0.1]), method="dopri5"
        )


def test_the_explicit_form_takes_it():
    t = torch.linspace(0, 0.04, 3, dtype=torch.float64)
    soft = tb.Section.from_stiffness(EA=40.0, GA=20.0, GJ=0.08, EI=0.1, mass=0.2, inertia=1e-3)
    beam = tb.Beam.straight(1.0, 2, soft)
    ways = [
        tb.simulate(tb.Scene(beam, [tb.Gravity(G), own]), t, method="dopri5", rtol=1e-9).nodes
        for own in (Tie((-1, 0), 3.0), tb.Spring(-1, 3.0, to=(0.0, 0, 0)))
    ]
    assert_close(*ways, rtol=0, atol=1e-9)


def test_modes_of_two_bodies_and_their_momentum():
    masses, stiffness = (2.0, 3.0), 50.0
    bodies = {
        name: tb.Body(mass=mass, inertia=0.1, position=(0.0, 0.0, 0.0))
        for name, mass in zip("ab", masses, strict=True)
    }
    scene = tb.Scene(bodies, [Tie(("a", "b"), stiffness)])
    state = tb.rest(scene)
    frequency = tb.modes(scene, state=state, count=12).frequency.max()
    known = (stiffness * (1 / masses[0] + 1 / masses[1])) ** 0.5
    assert_close(frequency, torch.tensor(known, dtype=torch.float64), rtol=1e-9, atol=0)
    thrown = replace(state, velocity=state.velocity + torch.tensor([[0.0, 1, 0], [0, 0, 2]]))
    stepper = tb.Stepper(scene, 0.01, tolerance=1e-13)
    after = thrown
    for _ in range(10):
        after = stepper(after)
    m = torch.tensor(masses, dtype=torch.float64)[:, None]
    assert_close((m * after.velocity).sum(0), (m * thrown.velocity).sum(0), rtol=0, atol=1e-12)
    assert (after.velocity - thrown.velocity).abs().max() > 0.1


@pytest.mark.parametrize("make", [braced, racked])
def test_a_sample_in_a_batch_is_the_sample_alone(make):
    stiffness = torch.linspace(0.5, 8.0, 40, dtype=torch.float64)
    together = moved(make(stiffness), "compiled")
    for k in (0, 17, 39):
        alone = moved(make(stiffness[k]), "eager")
        assert_close(together.position[k], alone.position, rtol=0, atol=1e-12)
        if alone.memory is not None:
            assert_close(together.memory[k], alone.memory, rtol=0, atol=1e-12)


def test_error_control_keeps_its_tolerance():
    t = torch.linspace(0, 0.2, 3, dtype=torch.float64)
    known = tb.simulate(linkage(2.0), t, step=2e-4).nodes
    held = tb.simulate(linkage(2.0), t, rtol=1e-4)
    assert (held.status == 0).all()
    size = (known - known[0]).abs().max()
    assert (held.nodes - known).abs().max() < 1e-4 * size


def test_copies_and_files(tmp_path):
    scene = braced(torch.tensor([2.0, 5.0]))
    for made in (copy.deepcopy(scene), pickle.loads(pickle.dumps(scene)), detached(scene)):
        assert made.interactions[0].nodes == (4, 2, 1)
        assert_close(made.interactions[0].stiffness, scene.interactions[0].stiffness)
    assert [one.name for one in leaves(scene.interactions[0])] == ["stiffness", "damping"]
    for own in (scene, racked(2.0)):
        state, file = moved(own, "eager"), io.BytesIO()
        torch.save(state, file)
        file.seek(0)
        again = torch.load(file, weights_only=True)
        for name in ("position", "stress", "memory"):
            assert_close(getattr(again, name), getattr(state, name), rtol=0, atol=0)
    assert "Bracing of nodes 4, 2, 1" in repr(scene)


@refusals(
    (lambda: Tie((-1,), 1.0), "between 1 nodes was given; two to 6 are wanted"),
    (lambda: Tie(range(7), 1.0), "between 7 nodes"),
    (lambda: braced(-1.0), "Bracing's stiffness = -1 was given"),
    (lambda: tb.Scene(tb.Beam.straight(1, 4, SECTION), Tie((-1, 4), 1.0)), "one node twice"),
    (
        lambda: tb.Scene(tb.Beam.straight(1, 4, SECTION), Tie((-1, 9), 1.0)),
        "a node of Tie = 9 was given",
    ),
    (
        lambda: tb.Scene(tb.Beam.straight(1, 4, SECTION, order=2), Tie((-1, 1), 1.0)),
        "inside of an element",
    ),
)
def test_what_does_not_fit_is_refused(make):
    make()


def test_an_acceleration_is_refused():
    with pytest.raises(TypeError, match="acceleration"):

        @dataclass(frozen=True)
        class Heavy(Interaction):
            depends = frozenset({ACCELERATION})


@pytest.mark.parametrize("engine", ["eager", "compiled"])
def test_what_mixes_samples_is_refused(engine):
    @dataclass(frozen=True)
    class Mixed(Interaction):
        depends = frozenset({POSITION})

        def wrench(self, point, t, inputs):
            pull = point.position.diff(dim=-2) - point.position.mean()
            return torch.cat((pull, -pull), -2), None

    load = tb.TipLoad(force=torch.rand(4, 3))
    scene = tb.Scene(tb.Beam.straight(1.0, 4, SECTION), [load, Mixed((-1, 1))])
    with pytest.raises(ValueError, match="mixes the samples"):
        moved(scene, engine)


@dataclass(frozen=True)
class Star(Interaction):
    """Springs of its nodes to their middle."""

    stiffness: Value = leaf(0)  # N/m

    depends = frozenset({POSITION})
    conservative = True

    def wrench(self, point, t, inputs):
        middle = point.position.mean(-2, keepdim=True)
        return -self.stiffness[..., None, None] * (point.position - middle), None


@dataclass(frozen=True)
class Couple(Interaction):
    """A force on one node, and its opposite on the other."""

    force: Value = leaf(1)  # N

    def wrench(self, point, t, inputs):
        return torch.stack((self.force, -self.force), -2), None


@pytest.mark.parametrize("nodes", [((3, 1, 2), (3, 1)), ((1, 2, 3), (3, 0))])
def test_interactions_of_other_numbers_of_nodes_beside_each_other(nodes):
    slopes = []
    for engine in ("eager", "compiled"):
        k = torch.tensor([2.0, 3.0], dtype=torch.float64, requires_grad=True)
        effects = [Star(own, one) for own, one in zip(nodes, k, strict=True)]
        scene = tb.Scene(tb.Beam.straight(1.0, 3, SECTION), [tb.Gravity(G), *effects])
        state = moved(scene, engine)
        slopes.append(torch.autograd.grad(state.position.square().sum(), k)[0])
    assert_close(*slopes, rtol=1e-9, atol=1e-14)


def test_it_is_raised_with_the_loads():
    """A path, and an equilibrium that is found by load steps, as by two loads."""
    beam, forces = tb.Beam.straight(1.0, 4, SECTION), ((0.0, 40.0, 0), (0.0, -40.0, 0))
    loads = [tb.PointLoad(node, force) for node, force in zip((-1, 1), forces, strict=True)]
    own = tb.Scene(beam, [Couple((-1, 1), forces[0])])
    assert_close(
        tb.equilibrium(own).position, tb.equilibrium(tb.Scene(beam, loads)).position,
        rtol=0, atol=1e-10,
    )  # fmt: skip
    assert tb.path(own, steps=4).factor[-1] > 0


def test_what_leaves_the_plane_is_refused():
    beam, force = tb.Beam.straight(1.0, 4, SECTION), (0.0, 0, 1.0)
    with pytest.raises(ValueError, match="out of the plane"):
        tb.equilibrium(tb.Scene(beam, [Couple((-1, 1), force)], plane="xy"))
    asked = [
        tb.equilibrium(tb.Scene(beam, [Couple((-1, 1), force)], plane=plane)).position
        for plane in (None, "auto")
    ]
    assert_close(*asked, rtol=0, atol=1e-12)


def test_a_finer_mesh_has_it_at_the_same_places():
    scene = tb.Scene(tb.Beam.straight(1.0, 2, SECTION), [tb.Gravity(G), Tie((1, -1), 300.0)])
    chosen = tb.remesh(scene, 4)
    assert chosen.interactions[0].nodes == (2, 4)


def test_a_linear_model_knows_links_alone_and_refuses_what_it_cannot_say():
    """A beam without joints, two nodes of which a link holds: the frequencies of the linear model
    are those of `modes`, and of the beam with `Distance`. Its state vector, and modes of what
    yields to its own force, are refused in a sentence.
    """
    beam, found = {"beam": tb.Beam.straight(1.0, 4, SECTION)}, []
    gravity, clamp = tb.Gravity(G), tb.Support(("beam", 0))
    nodes = (("beam", 1), ("beam", 4))
    for own in (dict(effects=[Link(nodes, 0.75)]), dict(joints=[tb.Distance(*nodes)])):
        effects = [gravity, *own.pop("effects", ())]
        scene = tb.Scene(beam, effects, supports=[clamp], **own)
        rest = tb.equilibrium(scene)
        model = tb.linearize(scene, rest)
        speeds = torch.linalg.eigvals(model.A).imag.sort().values
        found.append((tb.modes(scene, state=rest, count=3).frequency, speeds))
        assert_close(speeds[speeds > 1e-6][:3], found[-1][0], rtol=1e-6, atol=1e-6)
    for ours, known in zip(*found, strict=True):
        assert_close(ours, known, rtol=1e-7, atol=1e-7)
    linked = tb.Scene(beam, [gravity, Link(nodes, 0.75)], supports=[clamp])
    with pytest.raises(ValueError, match="state vector of a scene with an Interaction"):
        tb.linearize(linked).departure(tb.rest(linked))
    between = Between((*nodes, ("beam", 2)), 0.1)
    yielding = tb.Scene(beam, [gravity, between], supports=[clamp])
    for ask in (tb.modes, tb.linearize):
        with pytest.raises(ValueError, match="whose residual depends on its own unknowns"):
            ask(yielding)


def test_along_a_path_it_goes_with_a_support_that_the_load_moves():
    """The slope by the factor is the eager one: the corrections that are left are rounding."""
    pushed = tb.Support(-1, rotation="", displacement=(-0.05, 0.2, 0.0))
    tied = [Tie((2, 4), 300.0)]
    scene = tb.Scene(tb.Beam.straight(1.0, 4, SECTION), tied, supports=[tb.Support(0), pushed])
    ways = [tb.path(scene, steps=4, engine=engine) for engine in ("eager", "compiled")]
    assert_close(*(way.factor for way in ways), rtol=0, atol=1e-14)
    assert_close(*(way.state.position for way in ways), rtol=0, atol=1e-13)


def test_what_it_leaves_in_a_free_vibration_is_described():
    """By `in_free_vibration`, as that of a load: its frequencies are those of `modes`."""

    @dataclass(frozen=True)
    class Left(Gear):
        def in_free_vibration(self):
            return self

    beam = tb.Beam.straight(1.0, 4, SECTION)
    scenes = [tb.Scene(beam, acts) for acts in ([], [Left((-1, 2), stiffness=50.0)])]
    found = [
        ", ".join(f"{float(w):.4g}" for w in tb.modes(scene, count=3).frequency) for scene in scenes
    ]
    assert found[0] != found[1]
    for scene, frequencies in zip(scenes, found, strict=True):
        assert f"frequencies  {frequencies} rad/s" in str(tb.describe(scene))


def test_gears_that_remember_their_turns_run_on():
    """A torque on the driver: its angle is M t^2/(2 (J_1 + n^2 J_2)), ten turns of the driven one.
    Angles of the midpoint rule err by (rate dt)^2/12 of the rates, here 1 % at the end.
    """
    wheels = {"driver": tb.Body(1.0, 0.01), "driven": tb.Body(1.0, 0.005, position=(0.3, 0, 0))}
    torques = {"driver": 2.0, "driven": None}
    joints = [tb.Hinge(None, n, axis=(0, 0, 1), torque=m) for n, m in torques.items()]
    scene = tb.Scene(wheels, [Gears(tuple(wheels), 2.0)], joints=joints)
    run = tb.simulate(scene, [0.0, 0.5, 1.0], step=2.5e-3, engine="compiled")
    driver, driven = (joint.coordinate.squeeze() for joint in run.joint)
    assert run.status == 0 and driven[-1] < -20 * torch.pi
    assert torch.allclose(driven, -2 * driver, atol=1e-9)
    closed = run.t.double() ** 2 / (0.01 + 4 * 0.005)
    assert torch.allclose(driver.double(), closed, rtol=1e-2)
    assert torch.allclose(run.state.memory[-1, 0], torch.stack((driver[-1], driven[-1])))
