"""Functions of loads on sites alone: a flow, a load of a user, and one with internal states."""

import torch


def wind(x, t):
    return torch.stack((torch.sin(x[..., 1]), x[..., 0] * x[..., 2], t * x[..., 0]), -1)


def user(position, rotation, velocity, spin, t, u):
    force = rotation[..., :, 2] * (position * velocity).sum(-1, keepdim=True) + u * t
    return force, torch.linalg.cross(spin, position)


def lagged(position, rotation, velocity, spin, t, z):
    return rotation[..., :, 1] * z[..., :1], z[..., 1:] * velocity


def lag(z, position, rotation, velocity, spin, t):
    return torch.cat(
        (
            position[..., :1] - 3 * z[..., :1],
            z[..., :1] - z[..., 1:] * (1 + velocity[..., :1] ** 2),
        ),
        -1,
    )
