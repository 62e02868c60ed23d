"""Frameworks: chains next to each other, single nodes and joints, of trees and of loops, against
dense matrices.
"""

import pytest
import torch
from torch.testing import assert_close

from torchbeam.topology.framework import Framework

W = 3
CASES = {  # chains, singles, joints as (chain, end) or single numbers; None = the ground
    "a line": ((4,), 0, ()),
    "no joints": ((3, 1), 0, ()),
    "a tree": ((3, 2, 2), 0, (((0, 3), (1, 0)), ((0, 1), (2, 0)))),
    "a loop to the ground, with a body": (
        (2, 3),
        1,
        (((0, 0), None), ((0, 2), 0), (0, (1, 0)), ((1, 3), (0, 0))),
    ),
    "bodies alone": ((), 2, ((0, 1), (1, None))),
    "lines alike between others": (
        (3, 1, 3, 2),
        0,
        (((0, 0), (1, 0)), ((0, 3), (1, 1)), ((2, 0), (1, 0)), ((2, 3), (3, 2))),
    ),
    "neighbours": ((2, 1), 0, (((0, 1), (1, 0)), ((0, 2), (1, 1)), (None, (0, 0)))),
}

ALL = slice(None)
HELD = {  # rows of nodes, and which moves
    "nothing": (),
    "a roller": ((0, 0),),
    "an end": ((0, ALL),),
    "more of an end and a roller": ((slice(2), ALL), (2, 1)),
    "the last": ((-1, ALL),),
    "all but one": ((slice(-1), ALL),),
}


def framework(name, order):
    chains, singles, joints = CASES[name]
    starts = [sum(order * N + 1 for N in chains[:k]) for k in range(len(chains) + 1)]

    def row(at):
        return (
            None
            if at is None
            else starts[-1] + at
            if isinstance(at, int)
            else starts[at[0]] + order * at[1]
        )

    return Framework(order, chains, singles, tuple((row(a), row(b)) for a, b in joints))


GENERATOR = torch.Generator()


@pytest.fixture(autouse=True)
def seeded():
    GENERATOR.manual_seed(3)


def random(*shape):
    return torch.randn(*shape, generator=GENERATOR)


def columns_of(matrix, nodes, batch=()):
    """What a matrix does to vectors, as a dense one."""
    unit = torch.eye(nodes * W).view(-1, *(1,) * len(batch), nodes, W)
    return matrix.times(unit).flatten(-2).movedim(0, -1)


def system(of, batch=(), held_by="a roller"):
    """A random matrix with some moves held, whose diagonal dominates; its matrix, and the same as a
    dense one.
    """
    n, J = range(of.order + 1), len(of.joints)
    matrix = of.matrix(tuple(tuple(random(*batch, of.element_count, W, W) for _ in n) for _ in n))
    matrix = matrix.plus(9 * torch.eye(W).expand(of.node_count, W, W))
    held = torch.ones(J, W)
    held[:, 0] = 0  # fewer constraints than there are moves
    held[1::2, 1] = 0
    if J:
        blocks = random(*batch, J, 3, 3, W, W)
        blocks[..., :2, 2, :, :] *= held[:, None, None, :]
        blocks[..., 2, :2, :, :] *= held[:, None, :, None]
        blocks[..., 2, 2, :, :] = torch.diag_embed(1 - held)
        matrix = matrix.tied_too(of.joint_ties, of.of_ties(blocks), held)
    moving = torch.ones(of.node_count, W, dtype=torch.bool)
    joined = [node for pair in of.joints for node in pair if node is not None]
    if of.chains:
        for rows, columns in HELD[held_by]:
            moving[rows, columns] = False
            moving[joined] = True
    dense = columns_of(matrix, of.node_count + J, batch)
    free = torch.cat((moving.flatten(), held.flatten() > 0))
    return matrix, of.unknowns(moving, held.new_zeros(())), dense, free


@pytest.mark.parametrize("held_by", HELD)
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", CASES)
def test_solves_as_a_dense_matrix(name, order, held_by):
    """Forward, and backward by the transposed matrix, whatever supports hold."""
    of = framework(name, order)
    matrix, unknowns, dense, free = system(of, (2,), held_by)
    b = random(2, of.node_count + len(of.joints), W).requires_grad_()
    x = matrix.restricted(unknowns).solve(b)
    part = dense[:, free][..., free]
    expected = (
        torch.zeros_like(b)
        .flatten(-2)
        .index_copy(-1, free.nonzero()[:, 0], torch.linalg.solve(part, b.flatten(-2)[:, free]))
    )
    assert_close(x.flatten(-2), expected, rtol=1e-9, atol=1e-9)
    weights = random(*expected.shape)
    slopes = [torch.autograd.grad((weights * y).sum(), b)[0] for y in (x.flatten(-2), expected)]
    assert_close(*slopes, rtol=1e-9, atol=1e-9)  # of matrices whose condition chance makes


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", CASES)
def test_what_nodes_and_elements_say_to_each_other(name, order):
    """`scatter` is the transpose of `gather`; the matrix of nodes as a dense one is what it does to
    vectors.
    """
    of = framework(name, order)
    x = random(of.node_count, W)
    parts = tuple(random(of.element_count, W) for _ in range(order + 1))
    if of.element_count:
        both = sum((a * b).sum() for a, b in zip(of.gather(x), parts, strict=True))
        assert_close((x * of.scatter(parts)).sum(), both)
        matrix = of.matrix(
            tuple(tuple(random(of.element_count, W, W) for _ in parts) for _ in parts)
        )
        assert_close(matrix.dense() @ x.flatten(), matrix.times(x).flatten())
        assert_close(matrix.rows((0, 1)).times(x), matrix.times(x)[:2])


@pytest.mark.parametrize("held_by", HELD)
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", CASES)
def test_pivots_tell_what_is_stable(name, order, held_by):
    """Of a symmetric matrix with constraints: as many negative pivots as negative eigenvalues of
    the moves that these leave; positive definite where there is none.
    """
    of = framework(name, order)
    for shift in (8.0, -1.0):
        matrix, unknowns, dense, free = system(of, (), held_by)
        n = of.node_count * W
        tied = matrix.tied
        if tied is not None:
            tied = (tied + tied[..., matrix.framework.cut.tied_back, :, :].mT) / 2
        swapped = [matrix.couplings[k] for k in (1, 0, 3, 2)[: 2 * order]]
        matrix = type(matrix)(
            matrix.framework,
            (matrix.diagonal + matrix.diagonal.mT) / 2 + shift * torch.eye(W),
            tuple((A + B.mT) / 2 for A, B in zip(matrix.couplings, swapped, strict=True)),
            tied,
            matrix.held,
        )
        J = len(of.joints)
        dense = columns_of(matrix, of.node_count + J)
        keep = free[:n]
        K, G = dense[:n, :n][keep][:, keep], dense[n:, :n][:, keep]
        moves = (
            torch.eye(len(K)) if not J else torch.linalg.svd(G).Vh[torch.linalg.matrix_rank(G) :].mT
        )
        expected = torch.linalg.eigvalsh(moves.mT @ K @ moves)
        restricted = matrix.restricted(unknowns)
        pivots, sound = restricted.pivots()
        assert bool(sound)
        assert int((torch.linalg.eigvalsh(pivots) < 0).sum()) == int((expected < 0).sum())
        assert bool(restricted.positive_definite()) == bool((expected > 0).all())
