"""A decaying signal, by parameters by name: a model of identification whose derivatives are known
by hand.
"""

import torch

T = torch.linspace(0, 2, 40)


def wave(theta):
    """a exp(-b t) (N, T), by name."""
    return theta["a"][:, None] * torch.exp(-theta["b"][:, None] * T)


CLEAN = 2.0 * torch.exp(-0.7 * T)
NOISE = 0.05 * torch.randn(40, generator=torch.Generator().manual_seed(3))
