"""Interface: many nodes and multipliers are solved group by group, as dense systems are."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.topology import interface
from torchbeam.topology.cut import cut
from torchbeam.topology.elimination import condense, solve, transposed

W, EXACT = 3, dict(rtol=0, atol=1e-11)
# two lines and two single nodes; the last joint closes a loop by the ground
CHAINS, NODES = (3, 2), 9
PAIRS = ((0, None), (3, 4), (6, 1), (7, None), (8, None), (7, 8))
TIES = tuple(
    tuple(row for row in (*pair, NODES + k) if row is not None) for k, pair in enumerate(PAIRS)
)


@pytest.fixture
def structure():
    """(how, D, U, L, tied, held) of two samples: symmetric, positive definite where the constraints
    leave it free; of each joint two components are held.
    """
    how = cut(CHAINS, 2, PAIRS, TIES)
    make = torch.Generator().manual_seed(0)

    def draw(*shape):
        return torch.randn(*shape, generator=make)

    U = 0.3 * draw(2, 5, W, W)
    D = draw(2, NODES, W, W)
    D, held = D @ D.mT + 4 * torch.eye(W), torch.tensor([1.0, 1.0, 0.0]).expand(len(PAIRS), W)
    tied = []
    for nodes in TIES:
        n = len(nodes)
        blocks = torch.zeros(2, n, n, W, W)
        for i in range(n - 1):
            blocks[:, -1, i] = held[0][:, None] * draw(2, W, W)
            blocks[:, i, -1] = blocks[:, -1, i].mT
        blocks[:, -1, -1] = torch.diag(1 - held[0])
        tied.append(blocks.flatten(1, 2))
    return how, D, U, U.mT, torch.cat(tied, 1), held


def right(*shape):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(1))


def spied(monkeypatch, limit):
    """Whether systems are solved densely, of more than `limit` cubes of units not at once."""
    asked, densely = [], interface.Interface._densely
    monkeypatch.setattr(interface, "DENSE", limit)

    def spy(system, b):
        asked.append(system.count)
        return densely(system, b)

    monkeypatch.setattr(interface.Interface, "_densely", spy)
    return asked


def test_groups_solve_as_dense_systems_do(structure, monkeypatch):
    """And with the transposed matrix, and one right-hand side for all samples."""
    how, *parts = structure
    sides = right(2, NODES + len(PAIRS), W), right(NODES + len(PAIRS), W)
    both = parts, transposed(how, *parts)
    want = [solve(how, b, *of) for b in sides for of in both]
    asked = spied(monkeypatch, 0)
    assert_close([solve(how, b, *of) for b in sides for of in both], want, **EXACT)
    assert not asked


def test_a_sample_without_pivots_is_solved_densely(structure, monkeypatch):
    """One in which the joint that closes the loop, and comes last, holds what nothing else does;
    the other one's answer stays as it is by itself.
    """
    how, D, *parts = structure
    D = D.clone()
    D[1, 7:] = 0.0
    b = right(2, NODES + len(PAIRS), W)
    want = solve(how, b, D, *parts)
    asked = spied(monkeypatch, 0)
    x = solve(how, b, D, *parts)
    assert_close(x, want, **EXACT)
    assert asked == [len(how.interface) + how.multipliers]
    alone = [part if part.ndim < 4 else part[:1] for part in (D, *parts)]
    assert torch.equal(x[:1], solve(how, b[:1], *alone)) and len(asked) == 1
    system = condense(how, 0 * b, D, *parts)[0]
    assert system.definite(int(parts[-1].sum())).tolist() == [True, False]


@pytest.mark.parametrize(("node", "definite"), [(1, False), (4, False), (7, True)])
def test_signs_of_pivots(structure, node, definite):
    """As many are negative as there are constraints where the matrix is positive definite on what
    these leave free, here told by its eigenvalues (of node 7 they leave nothing).
    """
    how, D, *parts = structure
    D = D.clone()
    D[1, node] -= 9.0 * torch.eye(W)
    *_, held = parts
    system = condense(how, torch.zeros(NODES + len(PAIRS), W), D, *parts)[0]
    dense, n = system.dense(), len(how.interface) * W
    Z = torch.linalg.svd(dense[:, n:, :n]).Vh[:, int(held.sum()) :].mT
    want = (torch.linalg.eigvalsh(Z.mT @ dense[:, :n, :n] @ Z) > 0).all(-1)
    assert torch.equal(system.definite(int(held.sum())), want)
    assert want.tolist() == [True, definite]


def test_signs_of_pivots_do_not_depend_on_units(structure):
    """Of the moves, of which the second are in 1e-9, as of the forces of constraints."""
    how, D, *parts = structure
    D = D.clone()
    D[1, 4] -= 9.0 * torch.eye(W)
    unit = torch.tensor([1.0, 1e-9, 1e6])
    D, *parts[:3] = (unit[:, None] * x * unit for x in (D, *parts[:3]))
    constraints = int(parts[-1].sum())
    system = condense(how, torch.zeros(NODES + len(PAIRS), W), D, *parts)[0]
    assert system.definite(constraints).tolist() == [True, False]


def lattice(n):
    """n x n squares of two elements a side, welded, held at four corners."""
    section = tb.Section.from_stiffness(EA=1.4e7, GA=4e6, GJ=60.0, EI=(100.0, 400.0), mass=0.5)
    parts, at, joints = {}, {}, []
    for axis, (i, j) in ((a, (i, j)) for a in (0, 1) for i in range(n + 1) for j in range(n + 1)):
        end = (i + 1 - axis, j + axis)
        if max(end) <= n:
            name, way = f"{axis}{i}{j}", (1.0 - axis, float(axis), 0.0)
            root = (float(i), float(j), 0.0)
            parts[name] = tb.Beam.straight(1.0, 2, section, root=root, direction=way)
            for place, node in (((i, j), 0), (end, -1)):
                first = at.setdefault(place, (name, node))
                joints += [tb.Weld(first, (name, node))] if first != (name, node) else []
    corners = [tb.Support(at[place]) for place in ((0, 0), (n, 0), (0, n), (n, n))]
    return tb.Scene(parts, [tb.Gravity((0, 0, -9.81))], joints=joints, supports=corners)


def test_a_lattice_is_never_one_dense_system(monkeypatch):
    """Of 24 beams: equilibrium, that it is stable, and its gradient by the load."""
    scene = lattice(3)
    want = tb.equilibrium(scene, engine="eager").position
    asked = spied(monkeypatch, 1e4)
    assert_close(tb.equilibrium(scene, engine="eager").position, want, rtol=0, atol=1e-9)
    assert not asked
