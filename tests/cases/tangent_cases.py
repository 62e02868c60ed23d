"""The one oracle of tangents: a problem's linear solve against the derivative of its residual."""

from dataclasses import replace

import torch
from torch.func import jacfwd
from torch.testing import assert_close


def assert_newton_inverts(problem, x, nodes, strain):
    """The condensed solve gives (move, d stress, reaction) such that
    jvp(residual; move, d stress) = -residual of what is free, and the reaction is what the
    supports' balances are left with: one statement for the tangent, the condensation and the sweep.
    nodes, strain: absolute tolerances.
    """
    residual, *about = problem.residual(x)
    move, dstress, reaction = problem.linearise(x, *about).solve(residual.nodes, residual.strain)

    def g(move, dstress):
        fresh = replace(problem)
        r = fresh.residual(fresh.update(x, move, dstress))[0]
        return r.nodes, r.strain

    zero = torch.zeros_like(move), torch.zeros_like(dstress)
    _, (d_nodes, d_strain) = torch.func.jvp(g, zero, (move, dstress))
    constraints, left = problem.model.constraints, residual.nodes + d_nodes
    free = left[..., constraints.moving]
    assert_close(free, torch.zeros_like(free), rtol=0, atol=nodes)
    assert_close(d_strain, -residual.strain, rtol=0, atol=strain)
    held = left[..., list(constraints.nodes), :]
    assert reaction.shape[-2] == len(constraints.nodes)
    assert_close(reaction, constraints.fixed * held, rtol=0, atol=nodes)


def assert_touching_matrix(model, problem):
    """The matrix of what touches is the derivative of its forces by moves, near a step's start."""
    x, w = problem.apply_supports(problem.predictor()), model.space.unknowns
    shift = torch.randn(*x.u.shape[:-1], w, generator=torch.Generator().manual_seed(3))
    x = problem.update(x, 1e-4 * shift, torch.zeros_like(x.stress))
    zero = torch.zeros(model.node_count, w)

    def forces(move):
        moved = problem.update(x, move, torch.zeros_like(x.stress))
        kinematics = problem.motion.kinematics(moved.u, moved.m)
        return model.touching.loaded(zero, problem.node_motion(kinematics))

    kinematics = problem.motion.kinematics(x.u, x.m)
    assert forces(zero).abs().max() > 1
    wanted = jacfwd(forces)(zero).flatten(0, 1).flatten(-2)
    none = model.topology.diagonal(torch.zeros(*zero.shape, w))
    found = model.touching.matrix(none, x.stress, problem.node_motion(kinematics)).dense()
    assert_close(found, wanted, rtol=0, atol=1e-11 * wanted.abs().max())
