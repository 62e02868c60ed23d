"""Random scenes and states for the tests of the nodal form, and the order that a series of errors
shows.
"""

from dataclasses import replace

import torch

import torchbeam as tb
from torchbeam.extend import quaternions as quat

torch.set_default_dtype(torch.float64)


def spd(*shape, size=6):
    """Random symmetric matrices with eigenvalues above 1."""
    A = torch.randn(*shape, size, size)
    return A @ A.mT / size + torch.eye(size)


def inertia(second_moments):
    """That of a body with these second moments of mass (..., 3, 3), any positive matrix: tr(A)
    I - A.
    """
    return (
        second_moments.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None] * torch.eye(3)
        - second_moments
    )


def section(batch=(), coupled=True, rotary=True):
    """A section with every stiffness coupled to every other, and inertia about three axes that are
    not its own.
    """
    stiffness = spd(*batch) if coupled else torch.diag_embed(1 + torch.rand((*batch, 6)))
    mass = torch.zeros(*batch, 6, 6)
    mass[..., :3, :3] = (1 + torch.rand(batch))[..., None, None] * torch.eye(3)
    if rotary:
        mass[..., 3:, 3:] = inertia(0.05 * spd(*batch, size=3))
    return tb.Section(torch.linalg.inv(stiffness), mass).declared(
        coupled, offset=False, rotary=rotary
    )


def wave(*batch):
    """A smooth random function of t."""
    a, b = torch.randn(*batch, 3), torch.randn(*batch, 3)
    return lambda t: a * torch.sin(t + b)


def loads(batch=()):
    """Dead and follower loads on the tip, on a node and along the beam, constant and moving, and
    weight.
    """
    return [
        tb.TipLoad(force=wave(*batch), moment=wave(*batch)),
        tb.TipLoad(force=torch.randn(*batch, 3), moment=torch.randn(*batch, 3), follower=True),
        tb.PointLoad(force=wave(*batch), node=2, follower=True),
        tb.PointLoad(moment=torch.randn(3), node=1),
        tb.LineLoad(force=wave(*batch), moment=torch.randn(3), follower=True),
        tb.LineLoad(force=torch.randn(3)),
        tb.Gravity(torch.randn(3)),
    ]


def scene(N=4, batch=(), seed=0, effects=None, damping=None, order=1, **options):
    """A chain bent in space with every load, of N intervals between nodes; damping: None, "one" or
    "six".
    """
    torch.manual_seed(seed)
    steps = torch.tensor([1.0, 0, 0]) + 0.3 * torch.randn(*batch, N, 3)
    if order == 2:  # midside nodes about half way
        steps = steps[..., ::2, :].repeat_interleave(2, -2) + 0.1 * (
            steps - torch.tensor([1.0, 0, 0])
        )
    nodes = torch.cat((torch.zeros(*batch, 1, 3), steps.cumsum(-2)), -2)
    effects = loads(batch) if effects is None else list(effects)
    if damping:
        six = damping == "six"
        effects.append(tb.Damping(0.1 * torch.rand((*batch, 6) if six else batch), six=six))
    sections = [section(batch, **options) for _ in range(N // order)]
    return tb.Scene(tb.Beam.from_nodes(nodes, sections, order=order), effects)


def shape(nodes, batch=(), turn=0.4):
    """Positions and unit quaternions of nodes, random, neighbours turned by some `turn` rad against
    each other.
    """
    position = torch.arange(nodes)[:, None] * torch.tensor([1.0, 0, 0]) + 0.2 * torch.randn(
        *batch, nodes, 3
    )
    q = [quat.normalize(torch.randn(*batch, 4))]
    for _ in range(nodes - 1):
        q.append(quat.multiply(q[-1], quat.exponential(turn * torch.randn(*batch, 3))))
    return position, torch.stack(q, -2)


def state(of, seed=1, size=0.3):
    """A random state of a scene: clamped, its nodes moved, turned and in motion."""
    torch.manual_seed(seed)
    start = tb.rest(of)
    shape = start.position.shape

    def free(scale):
        return scale * torch.cat(
            (torch.zeros(*shape[:-2], 1, 3), torch.randn(*shape[:-2], shape[-2] - 1, 3)), -2
        )

    return replace(
        start, position=start.position + free(size),
        rotation=quat.multiply(quat.exponential(free(size)), start.rotation), velocity=free(1.0),
        spin=free(1.0), stress=torch.randn_like(start.stress),
    )  # fmt: skip


def energy_drifts(scene, t, steps, **options):
    """Largest |kinetic + strain - work| of midpoint runs over t, of the largest strain energy: one
    for each length of step.
    """
    runs = (tb.simulate(scene, t, step=step, **options).energy for step in steps)
    return [((e.kinetic + e.strain - e.work).abs().max() / e.strain.max()).item() for e in runs]


def orders(errors):
    """Observed order between neighbours of a series of errors whose step is halved each time."""
    errors = torch.as_tensor(errors)
    return torch.log2(errors[:-1] / errors[1:])
