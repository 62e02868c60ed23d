"""Local physics: one element and one node at a time give what the whole chain gives."""

from dataclasses import fields, replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.nodal_cases import scene, state
from torchbeam.equations.generalized_alpha import AlphaState, GeneralizedAlphaProblem
from torchbeam.equations.midpoint import MidpointProblem
from torchbeam.equations.step_element import Ends
from torchbeam.equations.step_kinematics import MidpointMotion
from torchbeam.nodal import loads as external
from torchbeam.nodal.assembly import Assembly
from torchbeam.nodal.conditions import conditions
from torchbeam.nodal.constitutive_law import times
from torchbeam.nodal.discretise import discretise
from torchbeam.nodal.mass import SharedMass
from torchbeam.topology.framework import Framework

N, BATCH = 3, (2,)
# behind that of the nodes or elements
AXES = {
    "length": 1, "reference": 1, "eigenstrain": 1, "S": 2, "C": 2, "retardation_time": 2,
    "position": 1, "rotation": 1, "velocity": 1, "spin": 1, "acceleration": 1, "chord": 1, "B": 2,
    "B_section": 2,
}  # fmt: skip


def at(x, k, axes=1):
    """One node or element, an axis of one; what all share as it is."""
    return x if x.shape[-1 - axes] == 1 else x.narrow(-1 - axes, k, 1)


def one(tree, k, **changes):
    """A tree of nodes or elements, of which one is left."""
    found = {
        f.name: getattr(tree, f.name)
        for f in fields(tree)
        if f.name in AXES and f.name not in changes
    }
    return replace(
        tree,
        **{name: at(x, k, AXES[name]) for name, x in found.items() if isinstance(x, torch.Tensor)},
        **changes,
    )


def beams(kind):
    turning = tb.Frame(
        velocity=torch.tensor([0.3, -0.2, 0.0]), angular_velocity=torch.tensor([0.2, 0.7, -0.4])
    )
    body = tb.PointMass(
        0.4, node=1, offset=torch.tensor([0.1, 0.2, -0.1]), inertia=0.02 * torch.eye(3)
    )
    curl = tb.Actuation(curvature=torch.tensor([0.1, 0.3, -0.2]))
    if kind == "space":
        return scene(N, BATCH, damping="six")
    if kind == "in a turning frame, eccentric":
        of = scene(N, BATCH, damping="one")
        return tb.Scene(of.beam, [*of.effects, body, curl], frame=turning)
    section = tb.Section.from_stiffness(EA=30.0, GA=10.0, GJ=2.0, EI=1.0, mass=0.5, inertia=0.05)
    effects = [
        tb.TipLoad(force=torch.tensor([0.2, 0.0, 0.5]), follower=kind == "plane"),
        tb.Gravity((0.0, 0, -1.0)),
        tb.Damping(0.1),
        tb.MassDamping(0.2),
    ]
    bent = torch.tensor([[0.0, 0, 0], [1.0, 0, 0.2], [1.8, 0, 0.7], [2.2, 0, 1.5]])
    beam = (
        tb.Beam.from_nodes(bent, section) if kind == "plane" else tb.Beam.straight(1.0, N, section)
    )
    if kind == "small":
        return tb.Scene(beam, effects, small=True)
    body = tb.PointMass(0.4, node=2, offset=torch.tensor([0.1, 0.0, -0.1]))
    spin = tb.Frame(angular_velocity=torch.tensor([0.0, 0.8, 0.0]))
    return tb.Scene(beam, [*effects, body], plane="xz", frame=spin)


KINDS = ["space", "in a turning frame, eccentric", "plane", "small"]


def element_of(problem, space, k):
    """One element of a step."""
    element, more = problem.element, {}
    if hasattr(element, "straining"):
        more = dict(straining=at(element.straining, k))
    found = one(
        element, k, law=one(problem.model.law, k), start=Ends(*(at(x, k) for x in element.start)),
        **more,
    )  # fmt: skip
    return (
        replace(found, space=replace(space, linear_element=one(space.linear_element, k)))
        if hasattr(space, "linear_element")
        else found
    )


def alpha_problem(of):
    """With generalized alpha, from a random state."""
    model = discretise(of)
    start, w, k = model.space.to_reduced(state(of)), model.space.unknowns, model.space.dims.strain
    known = AlphaState(
        **vars(start),
        acceleration=torch.randn(*BATCH, N + 1, 2 * w),
        straining=torch.randn(*BATCH, N, 2 * k),
    )
    return GeneralizedAlphaProblem(
        model, known, torch.tensor(0.1), torch.tensor(0.3), {}, rho_inf=0.7
    )


def midpoint_problem(of):
    model = discretise(of)
    return MidpointProblem(
        model, model.space.to_reduced(state(of)), torch.tensor(0.1), torch.tensor(0.3), {}
    )


def somewhere(problem):
    """A random iterate."""
    x = problem.predictor()
    push = 0.2 * torch.randn(*x.stress.shape[:-2], N, problem.model.space.unknowns)
    return problem.apply_supports(
        problem.update(x, torch.nn.functional.pad(push, (0, 0, 1, 0)), torch.randn_like(x.stress))
    )


def motion_of_node(problem, k):
    """One node of a step, with inertia of its own: what it shares with its neighbours is left
    out.
    """
    inertia = problem.model.inertia.of_nodes(slice(k, k + 1))
    clamps = problem.support_motions.clamps
    start = one(problem.start, k)
    if isinstance(problem.motion, MidpointMotion):
        own = tuple(c._replace(node=0) for c in clamps if c.node == k)
        return replace(problem.motion, inertia=inertia, start=start, clamps=own)
    return replace(problem.motion, inertia=inertia, start=start)


@pytest.mark.parametrize(
    "make, kind",
    [(midpoint_problem, kind) for kind in KINDS]
    + [(alpha_problem, kind) for kind in KINDS if "frame" not in kind and kind != "plane"],
)
def test_a_step_is_the_sum_of_its_elements_and_nodes(make, kind):
    """Residual, strain law and tangent of an implicit step at a random iterate: elements one by
    one, each with its share of the half-consistent mass, nodes one by one with inertia of their
    own, against the whole chain at once. To rounding: sums of some ten terms of up to 100.
    """
    problem = make(beams(kind))
    model, space = problem.model, problem.model.space
    alone, x = (
        Assembly(Framework(1, (1,)), space.interpolation, space.dims.position),
        somewhere(problem),
    )
    residual, *about = problem.residual(x)
    tangent = problem.linearise(x, *about)

    motions = [motion_of_node(problem, k) for k in range(N + 1)]
    ways = [motion.kinematics(at(x.u, k), at(x.m, k)) for k, motion in enumerate(motions)]
    forces = [motion.balance(way) for motion, way in zip(motions, ways, strict=True)]
    turns = [problem.TANGENT(*both) for both in zip(motions, ways, strict=True)]
    g = [own.wrench[..., 0, :] for own in forces]
    D = [turn.inertia(own).diagonal[..., 0, :, :] for turn, own in zip(turns, forces, strict=True)]
    U, L, gaps = [], [], []
    for e in range(N):  # one element
        pair = e, e + 1
        local = element_of(problem, space, e)
        poses = [
            Ends(
                *(y for ys in zip(*(ways[k].poses[instant] for k in pair), strict=True) for y in ys)
            )
            for instant in range(len(ways[e].poses))
        ]
        found = local.balance(at(x.stress, e), *poses)
        by = local.tangent(
            found, at(x.stress, e), lambda pair=pair: tuple(turns[k].half for k in pair)
        )
        force = alone.to_nodes(found.forces)
        matrix = alone.to_matrix(
            by.stiffness + by.force_operator.mT @ times(at(problem.C, e, 2), by.strain_by_move)
        )
        gaps.append(found.constitutive_residual)
        pushed, shared = shared_mass(
            problem,
            at(model.inertia.translational.coupling, e),
            *([parts[k] for k in pair] for parts in (motions, ways, turns)),
        )
        d, up, down = (matrix + shared).tensors
        for k in pair:
            g[k] = g[k] + force[..., k - e, :] + pushed[..., k - e, :]
            D[k] = D[k] + d[..., k - e, :, :]
        U.append(up[..., 0, :, :]), L.append(down[..., 0, :, :])

    nodes = problem.TANGENT(problem.motion, about[0])
    load = problem.external(about[0])
    assert_close(
        torch.stack(torch.broadcast_tensors(*g), -2) - load, residual.nodes, rtol=0, atol=1e-11
    )
    assert_close(torch.cat(torch.broadcast_tensors(*gaps), -2), residual.strain, rtol=0, atol=1e-12)
    whole = torch.stack(torch.broadcast_tensors(*D), -3) - problem.load_tangent(nodes)
    # node 0 is clamped
    D, L, U = (y[..., 1:, :, :] for y in (whole, torch.stack(L, -3), torch.stack(U, -3)))
    system = tangent.system
    for found, expected in ((D, system.D), (L, system.L), (U, system.U)):
        expected = expected[..., 1:, :, :]
        assert_close(found.expand_as(expected), expected, rtol=1e-12, atol=1e-10)


def shared_mass(problem, coupling, motions, ways, turns):
    """Of one element: what the mass that its two nodes share asks of them (..., 2, w), and the
    derivative, a matrix.
    """
    space, p = problem.model.space, problem.model.space.dims.position
    mass = SharedMass(Framework(1, (1,)), torch.zeros(2, 1), coupling, (-1.0, 1.0))

    def both(parts):
        return torch.cat(torch.broadcast_tensors(*parts), -2)

    if isinstance(problem.motion, MidpointMotion):
        before, after = (
            mass.momentum(both(v))
            for v in ([m.centre_velocity for m in motions], [w.centre_end for w in ways])
        )
        rate = motions[0]._rate(problem.frame.rate, before, after)
        levers = [w.lever for w in ways]
        by_spin = [t.lever_end for t in turns] if ways[0].lever.present else None
    else:
        rate = mass.momentum(both([w.true[..., :p] for w in ways]))
        levers, by_spin = [m.inertia.offset for m in motions], None
    lever = (
        replace(levers[0], offset=both([one.offset for one in levers]))
        if levers[0].present
        else levers[0]
    )
    if lever.present and not space.turns:
        lever = replace(lever, space=space)
    moved = None if by_spin is None else torch.cat(torch.broadcast_tensors(*by_spin), -3)
    wrench = lever.wrench(rate, torch.zeros_like(rate[..., : space.dims.spin]))
    masses = lever.prepared(mass.matrix(motions[0].Z), space.dims.spin)
    return wrench, lever.tangent(masses, lambda: moved, lambda: wrench)


def loaded(kind):
    """A scene with loads of every kind, on nodes and along the beam."""

    def user(r, R, v, w, t, acceleration, angular_acceleration):
        pull = (
            torch.linalg.cross(w, r)
            - 0.1 * acceleration
            + R[..., 1] * (v * v).sum(-1, keepdim=True)
        )
        return pull, torch.linalg.cross(angular_acceleration, R[..., 0]) + torch.linalg.cross(v, r)

    of = ("position", "rotation", "velocity", "spin", "acceleration", "angular_acceleration")
    more = [
        tb.Load(user, of=of, node=1),
        tb.Load(user, of=of, node=None),
        tb.MassDamping(0.3),
        tb.Drag(1.2, 0.4, added_mass=0.8),
    ]
    found = beams(kind)
    return tb.Scene(
        found.beam, [*found.effects, *more], frame=found.frame, plane=found.plane, small=found.small
    )


@pytest.mark.parametrize("kind", KINDS)
def test_loads_are_the_sum_of_each_on_each_node(kind):
    """Every load on every node by itself, on that node's own motion and with what a step knows of
    that node alone, against the loads of the chain at once, and their tangent likewise: to
    rounding.
    """
    problem = midpoint_problem(loaded(kind))
    model, t = problem.model, problem.t
    way = problem.residual(somewhere(problem))[1]
    nodes, motion = problem.nodes(way), problem.TANGENT(problem.motion, way)
    now = conditions(model, t, {})
    whole = external.external(model, nodes, now)
    wanted = external.tangent(model, nodes, now, external.motion_jacobian(motion, model.read))

    axes = (
        {}
        if nodes.frame is None
        else {"axes": tb.math.quaternions.matrix(model.space.public_frame(nodes.frame)).mT}
    )
    force, stiffness = torch.zeros_like(whole), torch.zeros_like(wanted)
    for k in range(N + 1):
        space, single = model.space.of_nodes(k), model.space.of_nodes(slice(k, k + 1))
        by = {name: at(y, k, 2) for name, y in external.motion_jacobian(motion, model.read).items()}
        here = nodes._replace(
            **{
                name: at(y, k)
                for name, y in nodes._asdict().items()
                if name in external.AT_NODES and y is not None
            }
        )
        for load in model.scene.loads:
            reads = model.depends_on(load)
            if load.node is None:
                place = dict(
                    mass=model.section_mass[..., k : k + 1, :, :],
                    s=model.s[..., k : k + 1],
                    elements=N,
                )
                point = external.load_point(single, load, reads, here, **place, **axes)
                length = model.tributary_length[..., k : k + 1, :]
                push = length * external.wrench(single, load, point, t, {})
                turn = external.wrench_tangent(single, load, point, t, {}, by)
                turn = turn if isinstance(turn, float) else length[..., None] * turn
            elif load.node % (N + 1) == k:
                point = external.load_point(space, load, reads, nodes.of(k, reads), **axes)
                push = external.wrench(space, load, point, t, {})[..., None, :]
                own = {name: y[..., 0, :, :] for name, y in by.items()}
                turn = external.wrench_tangent(space, load, point, t, {}, own)
                turn = turn if isinstance(turn, float) else turn[..., None, :, :]
            else:
                continue
            spot = torch.zeros(N + 1, 1)
            spot[k] = 1
            force, stiffness = force + spot * push, stiffness + spot[..., None] * turn
    assert force.abs().max() > 0.1 and stiffness.abs().max() > 0.1
    assert_close(force, whole, rtol=1e-12, atol=1e-12)
    assert_close(stiffness, wanted.expand_as(stiffness), rtol=1e-12, atol=1e-11)
