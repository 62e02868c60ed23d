"""Equilibria: internal states of loads."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb


@pytest.mark.parametrize("node", [-1, None])
def test_internal_states_come_to_rest_by_a_law_that_is_not_linear(node):
    """z + z^3 = p (1 - u/2) along z, u the node's displacement: to 1e-10, in a batch, the reaction
    that of the forces z; the derivative by p against central differences, 1e-5 to either side:
    solutions of 1e-12 leave 1e-7 of it.
    """
    beam = tb.Beam.straight(
        1.0, 4, tb.Section.from_stiffness(EA=10.0, GA=10.0, GJ=1.0, EI=1.0, mass=1.0)
    )
    p = torch.tensor([0.5, 1.0, 2.0], requires_grad=True)

    def found(p):
        def rate(z, x, R, v, w, t, p):
            pull = p[..., None] * torch.stack((0 * x[..., 0], 0 * x[..., 0], 1 - x[..., 2] / 2), -1)
            return (pull - z - z**3) / 0.1

        load = tb.Load(
            lambda x, R, v, w, t, z, p: (z, None), node=node, internal=3, rate=rate,
            of=("position",), values={"p": p if node == -1 else p[:, None]},
        )  # fmt: skip
        return tb.equilibrium(tb.Scene(beam, [load]), tolerance=1e-12)

    state = found(p)
    z = state.internal.unflatten(-1, (-1, 3))[..., 2]
    u = state.position[..., 2] if node is None else state.position[..., -1:, 2]
    assert_close(z + z**3, p[:, None] * (1 - u / 2), rtol=0, atol=1e-10)
    # what the law linearised at zero would have
    assert (z[:, -1] - p * (1 - u[:, -1] / 2)).abs().min() > 0.05
    each = torch.ones(1) if node == -1 else torch.tensor([0.125, 0.25, 0.25, 0.25, 0.125])
    assert_close(-state.root.force[:, 2], (each * z).sum(-1), rtol=0, atol=1e-10)
    (slope,) = torch.autograd.grad(state.tip.position[:, 2].sum(), p)
    after, before = (found(p.detach() + h).tip.position[:, 2] for h in (1e-5, -1e-5))
    assert_close(slope, (after - before) / 2e-5, rtol=0, atol=1e-7)


@pytest.mark.parametrize("load", [None, "p"])
def test_a_path_has_them_where_its_equilibria_have(load):
    """The same law, at the tip of two samples, raised by the factor of all loads, or by that of its
    pull p beside a dead force, from an equilibrium where that acts: points of the path are
    equilibria under their factor, to 1e-9 at a tolerance of 1e-12.
    """
    beam = tb.Beam.straight(
        1.0, 2, tb.Section.from_stiffness(EA=10.0, GA=10.0, GJ=1.0, EI=1.0, mass=1.0)
    )

    def scene(factor):
        def rate(z, x, R, v, w, t, p):
            return (
                (0.3 + p) * torch.stack((0 * x[..., 0], 0 * x[..., 0], 1 - x[..., 2] / 2), -1)
                - z
                - z**3
            ) / 0.1

        pushed = tb.Load(
            lambda x, R, v, w, t, z, p: (factor * z, None), node=-1, internal=3, rate=rate,
            of=("position",), inputs={"p": 1},
        )  # fmt: skip
        return tb.Scene(beam, [pushed, tb.TipLoad(force=factor * torch.tensor([0.0, 0.2, 0.0]))])

    one, p = torch.ones(1), torch.tensor([[0.5], [2.0]])
    initial = tb.equilibrium(scene(one), inputs={"p": 0 * p}, tolerance=1e-12) if load else None
    path = tb.path(
        scene(one), 1.0, load=load, step=0.5, initial=initial, tolerance=1e-12, inputs={"p": p}
    )
    assert path.reached.all() and path.valid.sum(0).min() > 2
    for state, factor in ((path.state[k], path.factor[k][:, None]) for k in (1, -1)):
        wanted = tb.equilibrium(
            scene(one if load else factor), inputs={"p": factor * p if load else p}, tolerance=1e-12
        )
        for name in ("position", "internal", "reaction"):
            assert_close(getattr(state, name), getattr(wanted, name), rtol=0, atol=1e-9)
