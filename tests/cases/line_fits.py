"""A line through readings, and noise that is alike from reading to reading."""

import torch

N = 60
T = torch.linspace(0, 1, N)
TRUE = torch.tensor([1.0, 2.0])


def line(theta):
    return theta["a"][:, None] + theta["b"][:, None] * T


def alike(seed, rho, n=N):
    random = torch.Generator().manual_seed(seed)
    e = torch.randn(n, generator=random)
    for k in range(1, n):
        e[k] = rho * e[k - 1] + (1 - rho * rho) ** 0.5 * e[k]
    return 0.05 * e
