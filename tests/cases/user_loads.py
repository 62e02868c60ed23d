"""Loads as users write them: contact, friction, fluids, magnets, tables, networks, by functions and
objects of every kind.

`LOADS` are for the tip of a beam of 1 m, or for all of it; `REFUSED` have no native code, each with
what the reason says.
"""

from __future__ import annotations

import enum
import functools
import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

import torchbeam as tb
from torchbeam.extend import VELOCITY, LoadEffect, Value, leaf

MU, EDGE = 0.3, torch.tensor([0.0, 0.0, -1.0])
EDGES, HEIGHTS = torch.tensor([-0.5, 0.0, 0.3, 0.9, 1.5]), torch.tensor([0.4, -0.2, 0.3, 0.1, 0.6])
SINES = torch.sin(torch.arange(9.0))
POLES = torch.tensor([[1.2, 0.0, 0.3], [0.8, 0.1, -0.4], [0.3, -0.2, 0.5]])
PLACES = torch.linspace(-1, 1, 21)
SPEEDS = torch.tanh(3 * PLACES)
GAINS, SCALE, DIAGONAL = np.array([0.1, 0.2, 0.3]), np.float64(0.7), np.eye(3) * 0.4
STIFFNESS = torch.tensor([[2.0, 0.1, 0.3], [0.1, 1.0, 0.0], [0.3, 0.0, 3.0]])


def along_z(f):
    return torch.stack((0 * f, 0 * f, f), -1)


def tanh_friction(x, R, v, w, t):
    return -MU * torch.tanh(v / 0.05), None


def relu_wall(x, R, v, w, t):
    return along_z(4e2 * torch.relu(-0.001 - x[..., 2]) ** 2), None


def soft_wall(x, R, v, w, t):
    depth = F.softplus(x[..., 2] - 0.01, beta=200.0)
    return along_z(-30.0 * depth - 0.3 * torch.sigmoid(depth * 50) * v[..., 2]), None


def cylinder(x, R, v, w, t):
    across = x - x.new_tensor([1.0, 0.0, -0.1]) * torch.ones_like(x)
    across = across * across.new_tensor([1.0, 0.0, 1.0])
    distance = torch.linalg.norm(across, dim=-1, keepdim=True).clamp(min=1e-6)
    normal = across / distance
    depth = (0.12 - distance).clamp(min=0.0)
    slip = v - (v * normal).sum(-1, keepdim=True) * normal
    return 50.0 * depth * normal - 2.0 * depth * torch.tanh(slip / 0.1), None


def sphere(x, R, v, w, t):
    gap = x - torch.tensor([1.0, 0.0, 0.2])
    return 3.0 * F.normalize(gap, dim=-1) * torch.exp(-gap.norm(dim=-1, keepdim=True) / 0.05), None


def corner(x, R, v, w, t):
    depth = torch.maximum(0.98 - x[..., 0], torch.minimum(x[..., 2], torch.zeros_like(x[..., 2])))
    return along_z(-5.0 * depth), None


def hertz(x, R, v, w, t):
    return along_z(20.0 * F.relu(0.05 - x[..., 2]) ** 1.5), None


def lugre(x, R, v, w, t, z):
    return along_z(
        -(40.0 * z[..., 0] + 0.3 * lugre_rate(z, x, R, v, w, t)[..., 0] + 0.1 * v[..., 2])
    ), None


def lugre_rate(z, x, R, v, w, t):
    slip = v[..., 2:3]
    level = (0.2 + 0.1 * torch.exp(-((slip / 0.05) ** 2))) / 40.0
    return slip - slip.abs() / level * z


def bouc_wen(x, R, v, w, t, z):
    return along_z(-3.0 * z[..., 0]), None


def bouc_wen_rate(z, x, R, v, w, t):
    slip = v[..., 2:3]
    return 8.0 * slip - 4.0 * slip.abs() * z.abs() * z - 2.0 * slip * z**2


def wagner(x, R, v, w, t, z):
    lift = (
        -2
        * math.pi
        * (0.5 * v[..., 2] / 10.0 + 0.0455 * 0.165 * z[..., 0] + 0.3 * 0.335 * z[..., 1])
    )
    return along_z(0.4 * lift), None


def wagner_rate(z, x, R, v, w, t):
    return -torch.tensor([0.0455, 0.3]) * 20.0 * z + v[..., 2:3]


def stalling(x, R, v, w, t):
    wind = torch.tensor([8.0, 0.0, 0.0]) - v
    angle = torch.atan2(-wind[..., 2], wind[..., 0]) + torch.asin(R[..., 2, 0].clamp(-0.999, 0.999))
    lift = torch.where(
        angle.abs() < 0.25, 2 * torch.pi * angle, 1.6 * torch.sign(angle) * torch.cos(angle)
    )
    return along_z(0.01 * wind.square().sum(-1) * lift), along_z(0 * lift)


def dipole(x, R, v, w, t):
    moment, field = R[..., :, 0] * 0.2, torch.tensor([0.1, 0.0, 1.0]) * torch.sin(30 * t)
    return None, torch.linalg.cross(moment, field.expand(moment.shape))


def dipoles(x, R, v, w, t):
    gap = x[..., None, :] - POLES
    near = gap / (gap.square().sum(-1, keepdim=True) + 0.01) ** 1.5
    return torch.einsum("...kc,k->...c", near, torch.tensor([0.02, -0.03, 0.01])), None


def table(x, R, v, w, t):
    z = x[..., 2].contiguous()
    k = (torch.searchsorted(EDGES, z) - 1).clamp(0, len(EDGES) - 2)
    share = (z - EDGES[k]) / (EDGES[k + 1] - EDGES[k])
    return along_z(HEIGHTS[k] * (1 - share) + HEIGHTS[k + 1] * share), None


def buckets(x, R, v, w, t):
    k = torch.bucketize(v[..., 2], EDGES).clamp(1, 4)
    return along_z(
        -torch.lerp(
            HEIGHTS[k - 1], HEIGHTS[k], (v[..., 2] - EDGES[k - 1]) / (EDGES[k] - EDGES[k - 1])
        )
    ), None


def even_table(x, R, v, w, t):
    place = ((x[..., 2] + 1.0) * 4.0).clamp(0.0, 7.999)
    k = place.long()
    return along_z(SINES[k] + (place - k) * (SINES[k + 1] - SINES[k])), None


def spline(x, R, v, w, t, s):
    """Catmull and Rom's through nine points along the beam."""
    place = (s / 1.0 * 8).clamp(0, 7.999)
    k = place.floor().long()
    u = place - k
    a, b, c, d = (SINES[(k + i).clamp(0, 8)] for i in (-1, 0, 1, 2))
    return along_z(
        b + 0.5 * u * (c - a + u * (2 * a - 5 * b + 4 * c - d + u * (3 * (b - c) + d - a)))
    ) * v[..., 2:3], None


def ramp(x, R, v, w, t):
    return along_z(
        0.5 * torch.erf((x[..., 2] - 0.01) / 0.02)
        + torch.special.expit(20 * (t - 0.02)) * v[..., 0]
    ), None


def scheduled(x, R, v, w, t):
    gain = torch.where(t < 0.015, 0.5, torch.clamp(20 * t, max=2.0))
    return -gain * v, None


def of_matrix(x, R, v, w, t):
    gap = x - torch.tensor([1.0, 0, 0])
    return -torch.einsum("ij,...j->...i", STIFFNESS, gap), -(R @ STIFFNESS @ R.mT @ w[..., None])[
        ..., 0
    ]


def implicit_drag(x, R, v, w, t):
    A = torch.eye(3) + 0.1 * v[..., :, None] * v[..., None, :]
    return -torch.linalg.solve(A, v), None


def potential(x):
    return 0.5 * (x[..., 2] - 0.02).square() + torch.log1p(x.square().sum(-1)) * 0.3


def conservative(x, R, v, w, t):
    return -torch.func.grad(lambda y: potential(y).sum())(x), None


def writing_its_own(x, R, v, w, t):
    f = torch.zeros_like(v)
    f[..., 2] = -0.4 * v[..., 2]
    f[..., 0] -= 0.1 * x[..., 0]
    return f, None


def radial_basis(x, R, v, w, t):
    near = torch.exp(-(((x[..., None, :] - POLES).norm(dim=-1) / 0.4) ** 2))
    return near @ torch.tensor([[0.1, 0.0, 0.3], [0.2, 0.0, -0.5], [0.0, 0.1, 0.2]]), None


def closure(k, c):
    def spring(x, R, v, w, t):
        return -k * (x - EDGE) - c * v, None

    return spring


def scaled(gain, offset, x, R, v, w, t):
    return gain * torch.tanh(x - offset), None


class Law(NamedTuple):
    k: float
    power: int


@dataclass
class Contact:
    """A wall whose numbers may change."""

    normal: torch.Tensor = field(default_factory=lambda: torch.tensor([0.0, 0.0, 1.0]))
    stiffness: float = 40.0
    settings: dict = field(default_factory=lambda: {"gap": [0.0, 0.01], "law": Law(2.0, 3)})

    def force(self, x, R, v, w, t):
        depth = ((x * self.normal).sum(-1, keepdim=True) - self.settings["gap"][1]).clamp(min=0)
        return -self.stiffness * self.normal * depth ** self.settings["law"].power, None

    def __call__(self, x, R, v, w, t):
        return self.force(x, R, v, w, t)


class Motor:
    """A controller with gains, of plain Python."""

    def __init__(self, gains):
        self.gains, self.limit, self.target = gains, 0.4, np.array([0.9, 0.0, 0.1])

    def torque(self, x, R, v, w, t):
        error = torch.as_tensor(self.target) - x
        f = sum(gain * part for gain, part in zip(self.gains, (error, -v), strict=True))
        return self.limit * torch.tanh(f / self.limit), None


@dataclass(frozen=True)
class Brake(LoadEffect):
    """A load of a class of one's own: quadratic, with a floor."""

    c: Value = leaf(0)
    floor: float = 0.01
    node = -1
    depends = frozenset({VELOCITY})

    def wrench(self, point, t, inputs):
        speed = torch.sqrt(point.velocity.square().sum(-1, keepdim=True) + self.floor**2)
        return -self.c[..., None] * speed * point.velocity, None


class Residual(nn.Module):
    """Layers with a jump over them, numbers that are no parameters, and a scale."""

    def __init__(self):
        super().__init__()
        self.first, self.second, self.scale = nn.Linear(6, 6), nn.Linear(6, 6), 0.5
        self.register_buffer("mean", torch.linspace(0, 1, 6))
        self.out = nn.Parameter(torch.linspace(-0.3, 0.3, 18).reshape(3, 6))

    def forward(self, y):
        y = (y - self.mean) * self.scale
        return (y + self.second(torch.nn.functional.silu(self.first(y)))) @ self.out.T


class Single(nn.Module):
    """A network of float32 in a scene of float64."""

    def __init__(self):
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(6, 5), nn.Tanh(), nn.Linear(5, 3)).float()

    def forward(self, y):
        return self.layers(y.float()).double()


def neural(*layers, train=False):
    """A load by a network of position and velocity; layers between the first and the last."""
    torch.manual_seed(0)
    whole = (
        nn.Sequential(nn.Linear(6, 6), *(layer() for layer in layers), nn.Linear(6, 3))
        .double()
        .train(train)
    )
    return network(whole)


def network(module):
    return tb.Load(
        lambda x, R, v, w, t: (0.3 * module(torch.cat((x, v), -1)), None),
        node=-1,
        of=("position", "velocity"),
    )


def shear(x, t):
    return torch.stack(
        (
            2.0 * (x[..., 2].abs() + 0.1) ** (1 / 7),
            0 * x[..., 1],
            0.1 * torch.sin(5 * t) + 0 * x[..., 2],
        ),
        -1,
    )


def vortex(x, t):
    gap = x - torch.tensor([0.5, 0.0, -0.3])
    return (
        torch.linalg.cross(torch.tensor([0.0, 1.0, 0.0]).expand(gap.shape), gap)
        * 0.5
        / (gap.square().sum(-1, True) + 0.05)
    )


def magnet(x, R, v, w, t, *, strength, pole):
    gap = pole - x
    return strength * gap / (gap.pow(2).sum(-1, keepdim=True) + 0.01).pow(1.5), None


def by_settings():
    k, (a, b), (c,) = 2.0, (0.1, 0.2), [0.3]
    return lambda x, R, v, w, t: (
        torch.stack([-k * a * v[..., 0], -b * v[..., 1], -c * x[..., 2]], -1),
        None,
    )


def walls(x, R, v, w, t):
    gap = x[..., 2].abs() - 0.0005
    f = torch.where(gap > 0, -400.0 * gap * x[..., 2].sign(), 0.0)
    return torch.stack([torch.zeros_like(f), torch.zeros_like(f), f], -1), None


def interpolated(x, places, values):
    k = torch.clamp(torch.searchsorted(places, x, right=True) - 1, 0, len(places) - 2)
    slope = (values[k + 1] - values[k]) / (places[k + 1] - places[k])
    return values[k] + slope * (x - places[k])


def by_table(x, R, v, w, t):
    return -0.2 * interpolated(v, PLACES, SPEEDS), None


def jacobian(x, R, v, w, t):
    slopes = torch.func.jacrev(lambda y: torch.sin(y) * y.sum())
    return -0.1 * torch.func.vmap(slopes)(x.reshape(-1, 3)).sum(-1).reshape(x.shape), None


def rate_of_a_field(x, R, v, w, t):
    _, change = torch.func.jvp(lambda y: torch.cos(y) * y, (x,), (v,))
    return -0.1 * change, None


def numbers(x, R, v, w, t):
    c = math.sqrt(2) * math.exp(-3) + float(GAINS[1])
    f = -c * v - torch.as_tensor(GAINS) * x * np.pi
    return f - SCALE * (torch.from_numpy(DIAGONAL) @ v[..., None])[..., 0], None


def node_by_node(x, R, v, w, t):
    f = torch.zeros_like(x)
    for k in range(x.shape[-2]):
        f[..., k, 2] = -0.1 * v[..., k, 2] * (1 + x[..., k, 0])
    return f, None


def of_rotations(x, R, v, w, t):
    across = torch.diag(torch.tensor([0.1, 0.2, 0.3]))
    turn = torch.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0],
                        R[..., 1, 0] - R[..., 0, 1]], -1)  # fmt: skip
    cosine = (R.diagonal(dim1=-2, dim2=-1).sum(-1, keepdim=True) - 1) / 2
    angle = torch.arccos(cosine.clamp(-1 + 1e-9, 1 - 1e-9))
    return -torch.einsum("...ij,jk,...lk,...l->...i", R, across, R, v), -0.3 * angle * turn


def softly(x, R, v, w, t):
    near = torch.softmax(-5 * (x[..., None, :] - POLES).square().sum(-1), -1)
    depth = torch.relu(x[..., 2])
    push = sum(c * depth**k for k, c in enumerate([0.1, -2.0, -30.0]))
    return 0.1 * near @ POLES - 0.1 * torch.cumsum(v, -1) + along_z(push), None


class Wrench(NamedTuple):
    force: torch.Tensor
    moment: torch.Tensor | None = None


class Axis(enum.Enum):
    ALONG, ACROSS = 0, 2


@dataclass
class Wind:
    speed: torch.Tensor
    density: float = 0.2

    def drag(self):
        return -self.density * self.speed * self.speed.abs()


def by_name(x, R, v, w, t):
    wind = Wind(v[..., Axis.ACROSS.value])
    return Wrench(-0.2 * torch.roll(v, 1, -1) + along_z(wind.drag()), moment=-0.01 * w)


def by_defaults(*motion, gain=torch.tensor([0.1, 0.2, 0.3])):  # noqa: B008
    return -gain * motion[2], None


class Recurrent(nn.Module):
    """A recurrent cell in continuous time: its hidden state follows what the cell says."""

    def __init__(self):
        super().__init__()
        torch.manual_seed(0)
        self.cell, self.out = nn.GRUCell(6, 4), nn.Linear(4, 3)

    def load(self):
        def rate(z, x, R, v, w, t):
            now = self.cell(torch.cat([x, v], -1).reshape(-1, 6), z.reshape(-1, 4))
            return 20.0 * (now.reshape(z.shape) - z)

        return tb.Load(
            lambda x, R, v, w, t, z: (0.3 * self.out(z), None), node=-1, internal=4, rate=rate
        )


class Attention(nn.Module):
    """Heads over position, velocity and spin."""

    def __init__(self):
        super().__init__()
        torch.manual_seed(0)
        self.heads = nn.MultiheadAttention(3, 1, batch_first=True)

    def __call__(self, x, R, v, w, t):
        words = torch.stack([x, v, w], -2).reshape(-1, 3, 3)
        return 0.1 * self.heads(words, words, words)[0].mean(-2).reshape(x.shape), None


class Regulator:
    """Numbers and a tensor, called as a function."""

    def __init__(self):
        self.kp, self.kd, self.target = 2.0, 0.1, torch.tensor([1.0, 0, 0.05])

    def __call__(self, x, R, v, w, t):
        return self.kp * (self.target - x) - self.kd * v, None


def tip(function, **more):
    return lambda: tb.Load(function, **{"node": -1, **more})


# fmt: off
LOADS = {
    "tanh friction": tip(tanh_friction, of="velocity"), "relu wall": tip(relu_wall, of="position"),
    "soft wall": tip(soft_wall),
    "cylinder": tip(cylinder), "sphere": tip(sphere), "corner": tip(corner),
    "Hertz contact": tip(hertz),
    "LuGre": tip(lugre, internal=1, rate=lugre_rate),
    "Bouc-Wen": tip(bouc_wen, internal=1, rate=bouc_wen_rate),
    "Wagner's lags": tip(wagner, internal=2, rate=wagner_rate),
    "stalling wing": tip(stalling, node=None),
    "magnetic dipole": tip(dipole), "three magnets": tip(dipoles), "table": tip(table),
    "buckets": tip(buckets),
    "even table": tip(even_table), "spline in s": tip(spline, node=None, of=("velocity", "s")),
    "ramp by erf": tip(ramp),
    "gain by time": tip(scheduled), "matrix": tip(of_matrix), "linear solve": tip(implicit_drag),
    "gradient of a potential": tip(conservative), "writes into its own": tip(writing_its_own),
    "radial basis": tip(radial_basis),
    "closure": lambda: tb.Load(closure(3.0, torch.tensor([0.1, 0.2, 0.3])), node=-1),
    "partial": tip(functools.partial(scaled, 0.4, torch.tensor([1.0, 0.0, 0.1]))),
    "method of a dataclass": lambda: tb.Load(Contact().force, node=-1),
    "callable object": lambda: tb.Load(Contact(stiffness=20.0), node=-1),
    "method of an object": lambda: tb.Load(Motor([0.8, 0.2]).torque, node=-1),
    "class of one's own": lambda: Brake(0.3),
    "shear flow": lambda: tb.Drag(100.0, 0.02, flow=shear),
    "vortex": lambda: tb.Drag(100.0, 0.02, flow=vortex),
    "network, tanh": lambda: neural(nn.Tanh), "network, ReLU": lambda: neural(nn.ReLU),
    "network, GELU": lambda: neural(nn.GELU),
    "network, SiLU": lambda: neural(nn.SiLU), "network, ELU": lambda: neural(nn.ELU),
    "network, Mish": lambda: neural(nn.Mish),
    "network, softplus": lambda: neural(nn.Softplus),
    "network, leaky": lambda: neural(nn.LeakyReLU),
    "network, sigmoid": lambda: neural(nn.Sigmoid),
    "network, Hardtanh": lambda: neural(nn.Hardtanh),
    "network, layer norm": lambda: neural(lambda: nn.LayerNorm(6), nn.Tanh),
    "network, dropout of eval": lambda: neural(nn.Dropout, nn.Tanh),
    "network, residual": lambda: network(Residual().double()),
    "network, float32": lambda: network(Single()),
    "partial by keywords": lambda: tb.Load(
        functools.partial(magnet, strength=0.05, pole=torch.tensor([1.0, 0, 0.3])), node=-1),
    "closure of tuples": lambda: tb.Load(by_settings(), node=-1),
    "walls by where": tip(walls), "interpolation": tip(by_table), "Jacobian": tip(jacobian),
    "rate of a field": tip(rate_of_a_field), "numbers of NumPy": tip(numbers),
    "loop over nodes": tip(node_by_node, node=None), "rotations": tip(of_rotations),
    "softmax and sums": tip(softly), "named tuple": tip(by_name),
    "tensor by default": tip(by_defaults),
    "recurrent cell": lambda: Recurrent().double().load(),
    "attention": lambda: tb.Load(Attention().double(), node=-1),
    "regulator": lambda: tb.Load(Regulator(), node=-1),
}
# fmt: on

THREE = torch.tensor([[3.0], [1.0], [2.0]])


def springs(k):
    """Of three beams, k (3, 1), beside numbers that all have in common: as many as there are
    beams.
    """
    return lambda x, R, v, w, t: (-k * (x - EDGE) - 0.1 * v, None)


def picking(k):
    """k (3): the same row of it by a place, and by its shape."""
    return lambda x, R, v, w, t: (
        -k[:, None] * v,
        k.reshape(k.shape[0], 1) * torch.sin(w) * STIFFNESS[0],
    )


def lagging(k):
    def pull(x, R, v, w, t, z):
        return along_z(-k[..., 0] * z[..., 0]), None

    def rate(z, x, R, v, w, t):
        return 20.0 * k * (x[..., 2:3] - z)

    return tb.Load(pull, node=-1, internal=1, rate=rate)


def mixing(k):
    """Each beam feels the largest of all, from 2 on."""
    return tb.Load(lambda x, R, v, w, t: (-k / k.max().clamp(min=2.0) * v, None), node=-1)


BATCHES = {  # of a tensor (3, 1), in loads that close over it
    "closed-over batch": lambda k: tb.Load(springs(k), node=-1),
    "batch by places": lambda k: tb.Load(picking(k[:, 0]), node=-1),
    "batch of a partial": lambda k: tb.Load(
        functools.partial(scaled, k, torch.tensor([1.0, 0.0, 0.1])), node=-1
    ),
    "batch of an object": lambda k: tb.Load(Motor([k, 0.2]).torque, node=-1),
    "batch of lags": lagging,
    "batch along the beam": lambda k: tb.Load(
        lambda x, R, v, w, t: (-k[:, None] * v, None), node=None
    ),
    "batch of a flow": lambda k: tb.Drag(100.0, 0.02, flow=lambda x, t: k[..., None] * shear(x, t)),
}


def branching(x, R, v, w, t):
    return (-v if v[..., 2].sum() > 0 else -2 * v), None


def by_numpy(x, R, v, w, t):
    return along_z(
        torch.as_tensor(np.interp(x[..., 2].detach().numpy(), EDGES.numpy(), HEIGHTS.numpy()))
    ), None


def noisy(x, R, v, w, t):
    return 0.1 * torch.randn(3), None


def ordered(x, R, v, w, t):
    return -v.sort(-1).values, None


def by_number(x, R, v, w, t):
    return torch.stack([-0.1 * (k + 1) * v[..., k, :] for k in range(v.shape[-2])], -2), None


def of_neighbours(x, R, v, w, t):
    return torch.cat([v[..., 1:, :] - v[..., :-1, :], 0 * v[..., :1, :]], -2), None


def of_mean(x):
    return along_z(x - x.mean(-1, keepdim=True))


OTHER_SITES = {
    "in time": dict(function=lambda x, R, v, w, t: (of_mean(t * v[..., 2]), None)),
    "by an input": dict(
        function=lambda x, R, v, w, t, u: (of_mean(u[..., 0] * v[..., 2]), None), inputs={"u": 1}
    ),
    "of values": dict(
        function=lambda x, R, v, w, t, q: (of_mean(q + v[..., 2]), None),
        values={"q": torch.tensor([1.0, 2.0, 3.0])},
    ),
    "of s": dict(
        function=lambda x, R, v, w, t, s: (along_z(s / s.max() + 0 * v[..., 2]), None),
        of=("velocity", "s"),
    ),
    "of a rate": dict(
        function=lambda x, R, v, w, t, z: (along_z(z[..., 0]), None),
        internal=1,
        rate=lambda z, x, R, v, w, t: v[..., 2:] + torch.roll(z, 1, -2) - z,
    ),
}


def without_gradient(x, R, v, w, t):
    with torch.no_grad():
        drag = 0.1 * v
    return -drag * x, None


class OwnDerivative(torch.autograd.Function):
    """The square, said to be constant."""

    generate_vmap_rule = True

    @staticmethod
    def forward(x):
        return x * x

    @staticmethod
    def setup_context(ctx, inputs, output):
        pass

    @staticmethod
    def backward(ctx, cotangent):
        return 0 * cotangent


def of_own_derivative(x, R, v, w, t):
    return -0.1 * OwnDerivative.apply(v), None


def of_math(x, R, v, w, t):
    return -v * math.sin(30 * t), None


def of_complex(x, R, v, w, t):
    z = torch.complex(v[..., 1], v[..., 2]) * 1j
    return torch.stack([0 * z.real, -z.real, -z.imag], -1), None


class Remembering:
    """A function with memory."""

    def __init__(self):
        self.log = []

    def force(self, x, R, v, w, t):
        self.log.append(float(t))
        return -v, None


REFUSED = {
    "branch": (tip(branching), "control flow by values cannot be traced"),
    "NumPy": (tip(by_numpy), "numpy of a traced tensor"),
    "noise": (tip(noisy), "random numbers were drawn"),
    "number of a site": (tip(by_number, node=None), "on other sites"),
    "neighbours": (tip(of_neighbours, node=None), "on other sites"),
    **{
        f"other sites, {name}": (functools.partial(tb.Load, node=None, **load), "on other sites")
        for name, load in OTHER_SITES.items()
    },
    "gradients off": (tip(without_gradient), "gradients switched off"),
    "autograd.Function": (tip(of_own_derivative), "gradients switched off"),
    "math of time": (tip(of_math), "functions of torch in the place of math's"),
    "complex numbers": (tip(of_complex), "real numbers by sin and cos are wanted"),
    "sorted": (tip(ordered), "torch.maximum and torch.minimum are wanted"),
    "memory": (
        lambda: tb.Load(Remembering().force, node=-1),
        "the value of a traced tensor was asked for",
    ),
    "dropout of train": (lambda: neural(nn.Dropout, train=True), "random numbers were drawn"),
}
