"""Random scenes and states for the tests of the mixed forms: every effect at once, seeded."""

import torch

import torchbeam.mixed.state as mixed_state
from torchbeam.mixed.model import MixedModel
from torchbeam.scene.beam import Beam
from torchbeam.scene.effects import LineLoad, PointLoad, TipLoad
from torchbeam.scene.scene import Frame, RootMotion, Scene
from torchbeam.scene.section import Section

torch.set_default_dtype(torch.float64)


def spd(*shape):
    A = torch.randn(*shape, 6, 6)
    return A @ A.mT + 3 * torch.eye(6)


def mass(*shape):
    """Any 6x6 mass with every coupling, whose rotary inertia a body can have."""
    M = spd(*shape)
    return M + torch.diag_embed(
        torch.tensor([0.0, 0, 0, 1, 1, 1])
        * M.diagonal(dim1=-2, dim2=-1)[..., 3:].sum(-1)[..., None]
    )


def wave(*shape):
    """A smooth function of t with random phases, in torch."""
    a, b = torch.randn(*shape, 3), torch.randn(*shape, 3)
    return lambda t: a * torch.sin(t + b) + b * t * t


def random_scene(N, batch=(), seed=0, effects=None, turning_frame=True, turn=0.3):
    """SPD compliance and mass per element, a chain bent in space (C^ab differs), root and frame in
    motion, dead and follower loads on the tip, an inner node and along the beam, all functions of
    t.
    """
    torch.manual_seed(seed)
    steps = torch.randn(*batch, N, 3) * 0.3 + torch.tensor([1.0, 0, 0])
    nodes = torch.cat((torch.zeros(*batch, 1, 3), steps.cumsum(-2)), -2) + 0.4
    sections = [Section(spd(*batch), mass(*batch)) for _ in range(N)]
    if effects is None:
        effects = (
            TipLoad(force=wave(*batch), moment=wave(*batch)),
            TipLoad(force=wave(*batch), follower=True),
            PointLoad(moment=torch.randn(3), node=N // 2, follower=True),
            PointLoad(force=wave(), node=0),
            LineLoad(force=wave(*batch), moment=torch.randn(3), follower=True),
            LineLoad(moment=wave(*batch)),
        )
    frame = Frame(velocity=wave(*batch), angular_velocity=wave(*batch) if turning_frame else None)
    phi = wave(*batch)
    root = RootMotion(displacement=wave(*batch), rotation=lambda t: turn * phi(t))
    return Scene(Beam.from_nodes(nodes, sections), effects, frame=frame, root=root)


def random_fields(N, batch=(), seed=1, size=0.7):
    torch.manual_seed(seed)
    return mixed_state.unpack(size * torch.randn(*batch, 24 * N + 12), N)


def random_chain(N, batch=(), seed=0, **options):
    return MixedModel(random_scene(N, batch, seed, **options), "block_rate")
