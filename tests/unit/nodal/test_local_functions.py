"""Local physics: one element and one node at a time give what the whole chain gives."""

from dataclasses import fields, replace

import pytest
import torch
from nodal_cases import scene, state
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.dynamics.midpoint import MidpointProblem
from torchbeam.dynamics.step_kinematics import MidpointMotion
from torchbeam.nodal.assembly import to_blocks, to_nodes
from torchbeam.nodal.constitutive_law import times
from torchbeam.nodal.discretise import discretise
from torchbeam.nodal.inertia import Momenta, exchange, with_levers

N, BATCH = 3, (2,)
AXES = {"mass": 1, "coupling": 1, "inertia": 2, "offset": 1, "length": 1, "reference": 1, "strain": 1, "eigenstrain": 1, "S": 2,
        "C": 2, "retardation": 2, "position": 1, "rotation": 1, "velocity": 1, "spin": 1, "frames": 1, "R": 2, "chord": 1,
        "B": 2, "B_section": 2}  # axes behind that of the nodes or elements


def at(x, k, axes=1):
    """One node or element, an axis of one; what all share as it is."""
    return x if x.shape[-1 - axes] == 1 else x.narrow(-1 - axes, k, 1)


def one(tree, k, **changes):
    """A tree of nodes or elements, of which one is left."""
    found = {f.name: getattr(tree, f.name) for f in fields(tree) if f.name in AXES and f.name not in changes}
    return replace(tree, **{name: at(x, k, AXES[name]) for name, x in found.items() if isinstance(x, torch.Tensor)}, **changes)


def beams(kind):
    turning = tb.Frame(velocity=torch.tensor([0.3, -0.2, 0.0]), angular_velocity=torch.tensor([0.2, 0.7, -0.4]))
    body = tb.PointMass(0.4, node=1, offset=torch.tensor([0.1, 0.2, -0.1]), inertia=0.02 * torch.eye(3))
    curl = tb.Actuation(curvature=torch.tensor([0.1, 0.3, -0.2]))
    if kind == "space":
        return scene(N, BATCH, damping="six")
    if kind == "in a turning frame, eccentric":
        of = scene(N, BATCH, damping="one")
        return tb.Scene(of.beam, [*of.effects, body, curl], frame=turning)
    section = tb.Section.from_stiffness(EA=30.0, GA=10.0, GJ=2.0, EI=1.0, mass=0.5, inertia=0.05)
    effects = [tb.TipLoad(force=torch.tensor([0.2, 0.0, 0.5]), follower=kind == "plane"), tb.Gravity((0.0, 0, -1.0)),
               tb.Damping(0.1), tb.MassDamping(0.2)]
    bent = torch.tensor([[0.0, 0, 0], [1.0, 0, 0.2], [1.8, 0, 0.7], [2.2, 0, 1.5]])
    beam = tb.Beam.from_nodes(bent, section) if kind == "plane" else tb.Beam.straight(1.0, N, section)
    if kind == "small":
        return tb.Scene(beam, effects, small=True)
    body = tb.PointMass(0.4, node=2, offset=torch.tensor([0.1, 0.0, -0.1]))
    spin = tb.Frame(angular_velocity=torch.tensor([0.0, 0.8, 0.0]))
    return tb.Scene(beam, [*effects, body], plane="xz", frame=spin)


def in_balance(inertia, pieces, h, way, omega):
    """[force; moment] of momenta before and after: their rates, and what turns with the frame."""
    before, after = pieces
    rates = Momenta(*((b - a) / h for a, b in zip(before, after, strict=True)))
    mean = Momenta(*((a + b) / 2 for a, b in zip(before, after, strict=True)))
    return inertia.balance(rates, lambda: mean, way.lever, omega)


@pytest.mark.parametrize("kind", ["space", "in a turning frame, eccentric", "plane", "small"])
def test_a_step_is_the_sum_of_its_elements_and_nodes(kind):
    """Residual, strain law and tangent of the midpoint step at a random iterate: elements one by one, each with its share of
    the half-consistent mass, nodes one by one with inertia of their own, against the whole chain at once. To rounding: sums of
    some ten terms of up to 100.
    """
    of = beams(kind)
    model = discretise(of)
    space, p, w = model.space, model.space.position, model.space.unknowns
    problem = MidpointProblem(model, space.to_reduced(state(of)), torch.tensor(0.1), torch.tensor(0.3), {})
    x = problem.predictor()
    push = 0.2 * torch.randn(*x.stress.shape[:-2], N, w)
    x = problem.update(x, torch.nn.functional.pad(push, (0, 0, 1, 0)), torch.randn_like(x.stress))
    residual, *about = problem.residual(x)
    tangent = problem.linearise(x, *about)

    x = problem.apply_supports(x)
    omega, start, h = problem.frame[1], problem.start, problem.h
    nodes, ways, halves, moved = [], [], [], []
    g, D, U, L, gaps = [0.0] * (N + 1), [0.0] * (N + 1), [], [], []
    for k in range(N + 1):  # one node
        own = one(model.inertia, k, coupling=None, space=one(space, k) if kind == "small" else space)
        here, held = one(start, k), tuple(s._replace(node=0) for s in problem.support_motions if s.node == k)
        motion = MidpointMotion(own, here, h, problem.frame, held)
        way = motion.kinematics(at(x.u, k), at(x.m, k))
        balance, turning = motion.balance(way)
        R = own.space.spin_matrix(way.q)
        half = own.space.mean_rotation(R, motion.R)
        g[k] = g[k] + balance[..., 0, :]
        D[k] = D[k] + motion.tangent(way, turning, half, *motion.theta_by_spin(way, R))[0][..., 0, :, :]
        nodes.append(motion), ways.append(way), halves.append(half)
        moved.append(None if way.lever is None else own.space.lever_matrix(own.lever(way.q_end)) @ half)
    load = problem.external(x, about[0])
    for e in range(N):  # one element
        i, j = e, e + 1
        local = one(problem.element, e, law=one(model.law, e))
        if kind == "small":
            local = replace(local, space=replace(space, element=one(space.element, e)))
        middle = (*(at(start.position + x.u, k) for k in (i, j)), ways[i].q, ways[j].q)
        end = (*(at(start.position + 2 * x.u, k) for k in (i, j)), ways[i].q_end, ways[j].q_end)
        found = local.balance(middle, end, at(x.stress, e))
        by = local.tangent(found.middle, found.end, at(x.stress, e), halves[i], halves[j])
        force = to_nodes(found.forces, p)
        C = at(problem.C, e, 2)
        d, up, down = to_blocks(by.stiffness + by.hB.mT @ times(C, by.E), p)
        gaps.append(found.gap)
        coupling = at(model.inertia.coupling, e)
        v = [(m.centre_velocity, m.velocity_end(way, m.spin_end(way))[1]) for m, way in ((nodes[k], ways[k]) for k in (i, j))]
        shared = [exchange(coupling, v_i, v_j) for v_i, v_j in zip(*v, strict=True)]  # before and after
        block = coupling[..., None] * nodes[i].Z
        for k, sign in ((i, 1), (j, -1)):
            pieces = [Momenta(sign * P, torch.zeros_like(nodes[k].start.spin)) for P in shared]
            inertia = nodes[k].inertia
            pushed = in_balance(inertia, pieces, h, ways[k], omega)
            g[k] = g[k] + force[..., k - e, :] + pushed[..., 0, :]
            levers = None if moved[k] is None else with_levers(-block, space.lever_matrix(ways[k].lever), moved[k])
            own = (levers if moved[k] is not None else torch.nn.functional.pad(-block, (0, w - p, 0, w - p))), None
            D[k] = D[k] + d[..., k - e, :, :] + inertia.tangent(own, None, pushed[..., :p], moved[k])[0][..., 0, :, :]
        for blocks, k, other, stiffness in ((U, i, j, up), (L, j, i, down)):
            mass = torch.nn.functional.pad(block, (0, w - p, 0, w - p)) if moved[k] is None else with_levers(
                block, space.lever_matrix(ways[k].lever), moved[other])
            blocks.append((stiffness + mass)[..., 0, :, :])

    load = load if isinstance(load, torch.Tensor) else torch.zeros_like(residual.nodes)
    assert_close(torch.stack(torch.broadcast_tensors(*g), -2) - load, residual.nodes, rtol=0, atol=1e-11)
    assert_close(torch.cat(torch.broadcast_tensors(*gaps), -2), residual.strain, rtol=0, atol=1e-12)
    R = space.spin_matrix(about[0].q)
    half, turns = space.mean_rotation(R, problem.motion.R), problem.motion.theta_by_spin(about[0], R)
    pushes = problem.load_tangent(x, about[0], R, turns[0], half, turns[1])
    whole = torch.stack(torch.broadcast_tensors(*D), -3) - pushes
    D, L, U = (y[..., model.constraints.first:, :, :] for y in (whole, torch.stack(L, -3), torch.stack(U, -3)))
    for found, expected in ((D, tangent.D), (L, tangent.L), (U, tangent.U)):
        assert_close(found.expand_as(expected), expected, rtol=1e-12, atol=1e-10)
