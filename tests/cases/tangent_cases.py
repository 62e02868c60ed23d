"""The one oracle of tangents: a problem's linear solve against the derivative of its residual."""

from dataclasses import replace

import torch
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
