"""Another topology than a chain, as a structure will be: nodal form, equations and solvers run with
one that a test has.
"""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.nodal_cases import scene, state
from tests.cases.star_topology import Star
from torchbeam.equations.load_steps import climb
from torchbeam.equations.midpoint import MidpointProblem
from torchbeam.equations.steady import Configuration, SteadyProblem
from torchbeam.linear.system_matrices import in_basis, of_nodes
from torchbeam.nodal.discretise import discretise
from torchbeam.nodal.rates import Rates
from torchbeam.solvers.implicit_gradient import implicit_gradient
from torchbeam.solvers.newton import newton

N, SHARED = 5, 3  # elements; the node at which the chain is cut
NODES = [0, 1, 2, 5, 4, 3]  # of the chain, in the star's order: the shared one last
ELEMENTS = [0, 1, 2, 4, 3]
ROUNDING = dict(rtol=0, atol=1e-12)  # of numbers near one


def chain(force, effects=(), **options):
    """Bent in space, damped, with loads at nodes and along it, a mass that is off its node, and a
    tip that turns about x.
    """
    of = scene(N, (2,), damping="one")
    lump = tb.PointMass(
        0.4, node=2, offset=torch.tensor([0.1, 0.2, -0.1]), inertia=0.02 * torch.eye(3)
    )
    effects = [effect for effect in of.effects if effect.node is None]
    effects += [tb.PointLoad(force=force, node=4, follower=True), lump]
    return tb.Scene(
        of.beam, effects, supports=[tb.Support(0), tb.Support(N, rotation="yz")], **options
    )


def star_of(chain):
    """The same scene with its nodes and elements in the star's order, and the star."""
    beam = chain.beam
    rows = {
        "nodes": NODES, "frames": NODES, "elements": ELEMENTS, "length": ELEMENTS,
        "compliance": ELEMENTS, "mass": ELEMENTS,
    }  # fmt: skip
    axis = {"length": -1, "compliance": -3, "mass": -3}
    rows = {
        name: getattr(beam, name).index_select(axis.get(name, -2), torch.tensor(at))
        for name, at in rows.items()
    }
    effects = [
        effect if effect.node is None else replace(effect, node=NODES.index(effect.node))
        for effect in chain.effects
    ]
    supports = [replace(support, node=NODES.index(support.node)) for support in chain.supports]
    place = {node: k for k, node in enumerate(NODES)}
    star = Star(
        legs=((0, 1, 2, 5), (3, 4, 5)),
        ends=tuple((place[e], place[e + 1]) for e in ELEMENTS),
        s=beam.topology.arclength(beam.length)[0, NODES],
    )
    return replace(chain, beam=replace(beam, **rows), effects=effects, supports=supports), star


def both(force, lumped=False, **options):
    """(model of the chain, model of the star)"""
    of = chain(force, **options)
    same, star = star_of(of)
    return discretise(of, lumped), discretise(same, lumped, topology=star)


def in_the_stars_order(x):
    return x[..., NODES if x.shape[-2] == N + 1 else ELEMENTS, :]


def stars(state):
    """The same state of the star."""
    names = ("position", "rotation", "velocity", "spin", "stress")
    return replace(state, **{name: in_the_stars_order(getattr(state, name)) for name in names})


def equilibrium(model):
    still = tb.rest(model.scene)
    problem = SteadyProblem(model, torch.tensor(0.0), {}, torch.ones(2))
    with torch.no_grad():
        start = Configuration(still.position, still.rotation, torch.zeros_like(still.stress))
        x, _, status = climb(problem, start, None)
    assert not status.any()
    return implicit_gradient(problem, x, status == 0)


def step(model, start):
    problem = MidpointProblem(model, start, torch.tensor(0.1), torch.tensor(0.3), {})
    outcome = newton(problem, problem.predictor())
    assert not outcome.status.any()
    x, reaction = implicit_gradient(problem, outcome.x, outcome.status == 0)
    after = problem.finish(x, reaction)
    return (
        after.position,
        after.rotation,
        after.velocity,
        after.spin,
        after.stress,
    ), after.reaction


def moved(chain):
    """In motion, but for its two ends."""
    found, still = state(chain, size=0.05), tb.rest(chain)
    tip = torch.arange(N + 1)[:, None] == N
    held = {
        name: torch.where(tip, getattr(still, name), getattr(found, name))
        for name in ("position", "rotation", "velocity", "spin")
    }
    return replace(found, **held)


@pytest.mark.parametrize("what", ["equilibrium", "step"])
def test_two_chains_that_share_a_node_are_one_chain(what):
    """The same beam as one chain and as two, each eliminated towards the node that they share:
    shape, stress, reactions, and their derivative by a load: to rounding.
    """
    force = (0.3 * torch.randn(2, 3, generator=torch.Generator().manual_seed(5))).requires_grad_()
    models = both(force)
    if what == "equilibrium":
        (expected, reaction), (found, other) = map(equilibrium, models)
    else:
        start = moved(models[0].scene)
        (expected, reaction), (found, other) = step(models[0], start), step(models[1], stars(start))
    for a, b in zip(expected, found, strict=True):
        assert_close(in_the_stars_order(a), b, **ROUNDING)
    assert_close(reaction, other, rtol=0, atol=1e-11)
    weights = [torch.randn_like(x, requires_grad=False) for x in expected]
    slopes = [
        torch.autograd.grad(sum((w * x).sum() for w, x in zip(of, parts, strict=True)), force)[0]
        for of, parts in ((weights, expected), (map(in_the_stars_order, weights), found))
    ]
    assert_close(*slopes, rtol=1e-11, atol=1e-12)


def test_small_motions_and_rates_of_two_chains():
    """Mass, damping and stiffness of the free moves, and accelerations of the explicit form: the
    same in another order.
    """
    force = torch.zeros(2, 3)
    models = both(force)
    found = [
        in_basis(
            model,
            *of_nodes(model, model.space.to_public(tb.rest(model.scene)), torch.tensor(0.0), {}),
        )[0]
        for model in models
    ]
    w = 6
    moves = torch.arange((N + 1) * w).view(N + 1, w)
    places = [model.constraints.moving.flatten().nonzero()[:, 0] for model in models]
    order = [(places[0] == k).nonzero()[0, 0] for k in moves[NODES].flatten()[places[1]]]
    order = torch.stack(order)
    for a, b in zip(*found, strict=True):
        assert_close(a[..., order, :][..., order], b, rtol=1e-12, atol=1e-12)
    start = moved(models[0].scene)
    accelerations = []
    for model, own in zip(both(force, lumped=True), (False, True), strict=True):
        rates = Rates(model, {})
        nodes, spin, _ = rates.unpack(torch.tensor(0.2), rates.pack(stars(start) if own else start))
        now = rates.conditions(torch.tensor(0.2))
        net, _ = rates.balance(now, nodes)
        a, alpha = rates.accelerations(now, nodes, spin, net)
        accelerations.append(rates.joined(torch.cat((a, alpha), -1), torch.zeros(2, 1, w)))
    assert_close(in_the_stars_order(accelerations[0]), accelerations[1], rtol=1e-11, atol=1e-11)


EA, GA, GJ, EI_Y, EI_Z = 50.0, 20.0, 0.7, 1.0, 1.6
LENGTHS, PARTS = (1.0, 0.7, 0.5), 3


def junction(load, **options):
    """Three legs, clamped at their feet, from the joint at the origin to -x, +x and -z: nodes from
    each foot on, then the
    joint.    All axes are those of frame a; the sections turn with their legs.
    """
    directions = torch.tensor([[-1.0, 0, 0], [1.0, 0, 0], [0.0, 0, -1.0]])
    nodes, ends, legs, compliance, length = [], [], [], [], []
    joint = 3 * PARTS
    for k, (to, L) in enumerate(zip(directions, LENGTHS, strict=True)):
        own = [k * PARTS + i for i in range(PARTS)]
        nodes += [L * (1 - i / PARTS) * to for i in range(PARTS)]
        legs.append((*own, joint))
        ends += list(zip(legs[-1], legs[-1][1:], strict=False))
        Q = torch.block_diag(*(axes_of(-to),) * 2)
        compliance += [
            Q @ torch.diag(1 / torch.tensor([EA, GA, GA, GJ, EI_Y, EI_Z])) @ Q.mT
        ] * PARTS
        length += [L / PARTS] * PARTS
    section = tb.Section.from_stiffness(EA=EA, GA=GA, GJ=GJ, EI=EI_Y, mass=0.2)
    plain = tb.Beam.straight(1.0, joint, section)
    beam = replace(
        plain, nodes=torch.stack([*nodes, torch.zeros(3)]), length=torch.tensor(length),
        coupled=True, compliance=torch.stack(compliance),
        frames=torch.tensor([1.0, 0, 0, 0]).expand(joint + 1, 4),
        elements=torch.tensor([1.0, 0, 0, 0]).expand(joint, 4),
    )  # fmt: skip
    of = tb.Scene(
        beam,
        [tb.PointLoad(force=load[:3], moment=load[3:], node=joint)],
        supports=[tb.Support(leg[0]) for leg in legs],
        **options,
    )
    return discretise(of, topology=Star(tuple(legs), tuple(ends), torch.zeros(joint + 1)))


def axes_of(along):
    """Columns: section axes of a leg in frame a, its y axis that of frame a."""
    y = torch.tensor([0.0, 1.0, 0.0])
    return torch.stack((along, y, torch.linalg.cross(along, y)), -1)


def stiffness(along, L):
    """(6, 6) of the joint, frame a, by a leg of equal elements: the inverse of what a force and a
    moment at the end of a cantilever bring about. Elements of constant curvature bend by L
    h^2/(12 EI) less (Gauss's rule for (L - s)^2).
    """
    h = L / PARTS
    # a force along y turns about z, one along z about -y
    bend = {"z": (EI_Z, 1.0), "y": (EI_Y, -1.0)}
    F = torch.diag(torch.tensor([L / EA, 0, 0, L / GJ, 0, 0]))
    for shift, turn, (EI, sign) in ((1, 5, bend["z"]), (2, 4, bend["y"])):
        F[shift, shift] = L / GA + L**3 / (3 * EI) - L * h**2 / (12 * EI)
        F[shift, turn] = F[turn, shift] = sign * L**2 / (2 * EI)
        F[turn, turn] = L / EI
    Q = torch.block_diag(*(axes_of(along),) * 2)
    return Q @ torch.linalg.inv(F) @ Q.mT


def test_a_junction_of_three_legs_is_as_stiff_as_they_are_together():
    """A T under a force and a moment, small displacements: the joint moves as the sum of the legs'
    stiffnesses says, in closed form; with large ones, supports carry the load, forces and moments
    about the origin.
    """
    load = torch.tensor([0.3, -0.2, 0.4, 0.05, 0.1, -0.08])
    # of a leg from its foot to the joint
    directions = torch.tensor([[1.0, 0, 0], [-1.0, 0, 0], [0.0, 0, 1.0]])
    whole = sum(stiffness(along, L) for along, L in zip(directions, LENGTHS, strict=True))
    for small in (True, False):
        model = junction(load, small=small)
        start = model.space.start(tb.rest(model.scene))
        problem = SteadyProblem(model, torch.tensor(0.0), {}, torch.tensor(1.0))
        start = Configuration(start.position, start.rotation, torch.zeros_like(start.stress))
        x, reaction, status = climb(problem, start, None)
        assert not status.any()
        # Newton's: 1e-8 of a force
        assert_close(reaction[:, :3].sum(0) + load[:3], torch.zeros(3), rtol=0, atol=1e-9)
        if small:
            moved = torch.cat((x.position[-1], x.rotation[-1]))
            assert_close(moved, torch.linalg.solve(whole, load), rtol=1e-9, atol=0)
        else:
            feet = x.position[list(model.constraints.nodes)]
            moment = torch.linalg.cross(feet, reaction[:, :3]).sum(0) + torch.linalg.cross(
                x.position[-1], load[:3]
            )
            assert_close(
                moment + reaction[:, 3:].sum(0) + load[3:], torch.zeros(3), rtol=0, atol=1e-9
            )
