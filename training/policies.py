"""Policies and value functions: small networks behind a running normalisation of what they see, and
their files.

from training.policies import load
policy = load("training/policies/reach-shac.pt")
action = policy(observation)                      # numpy or torch, (..., o) -> (..., a)
"""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from torchbeam.extend.commands import save as save_file

ACTIVATIONS = {"tanh": nn.Tanh, "elu": nn.ELU}
GAIN = 2**0.5  # of hidden layers
LIMIT = 10.0  # standard deviations; normalised observations are clipped there


class Statistics(nn.Module):
    """Mean and variance of everything seen so far, feature by feature (Chan, Golub and LeVeque
    1983); float64 buffers.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("count", torch.tensor(1e-4, dtype=torch.float64))
        self.register_buffer("mean", torch.zeros(size, dtype=torch.float64))
        self.register_buffer("variance", torch.ones(size, dtype=torch.float64))

    @torch.no_grad()
    def update(self, x: Tensor) -> None:
        """Take in x (..., size)."""
        x = x.detach().reshape(-1, len(self.mean)).double()
        n = len(x)
        total = self.count + n
        apart = x.mean(0) - self.mean
        spread = (
            self.variance * self.count
            + x.var(0, correction=0) * n
            + apart**2 * (self.count * n / total)
        )
        self.mean, self.variance, self.count = (
            self.mean + apart * (n / total),
            spread / total,
            total,
        )

    def forward(self, x: Tensor) -> Tensor:
        """x (..., size) with mean 0 and variance 1, clipped at 10."""
        return ((x - self.mean) / (self.variance + 1e-8).sqrt()).clamp(-LIMIT, LIMIT)


class Policy(nn.Module):
    """A normal distribution of actions: its mean from a network of the normalised observation, one
    deviation an action.

    sizes       (o, hidden ..., a)
    squash      True: actions are tanh of the normal ones (smooth at the bounds: for gradients
                through the environment). False: they are clipped by the environment (the density
                stays that of the normal: for likelihood ratios)
    deviation   of the normal at the start
    linear      whether the network has a linear `Shortcut`: most of what linear controllers teach
    gain        of the hidden layers' orthogonal weights at the start

    Calling it gives the most likely action, numpy for numpy and torch for torch, without noise,
    within [-1, 1].
    """

    def __init__(
        self,
        sizes: Sequence[int],
        *,
        squash: bool,
        activation: str = "tanh",
        deviation: float = 0.5,
        linear: bool = False,
        gain: float = GAIN,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        self.shape = dict(sizes=list(sizes), squash=squash, activation=activation, linear=linear)
        self.squash = squash
        self.statistics = Statistics(sizes[0])
        layers = network(sizes, activation, last=0.01, gain=gain)
        self.network = (Shortcut(layers) if linear else layers).to(dtype)
        self.log_deviation = nn.Parameter(
            torch.full((sizes[-1],), float(np.log(deviation)), dtype=dtype)
        )

    def mean(self, observation: Tensor) -> Tensor:
        """(..., a), before squashing."""
        return self.network(self.statistics(observation).to(self.log_deviation.dtype))

    def distribution(self, observation: Tensor) -> torch.distributions.Normal:
        return torch.distributions.Normal(
            self.mean(observation), self.log_deviation.exp(), validate_args=False
        )

    def act(self, observation: Tensor, noise: Tensor | None = None) -> Tensor:
        """(..., a) in the observation's dtype, differentiable; noise (..., a) standard normal."""
        x = self.mean(observation)
        if noise is not None:
            x = x + self.log_deviation.exp() * noise
        return (torch.tanh(x) if self.squash else x).to(observation.dtype)

    @torch.no_grad()
    def forward(self, observation: Any) -> Any:
        action = self.act(torch.as_tensor(observation)).clamp(-1, 1)
        return action if isinstance(observation, Tensor) else action.numpy()


class Shortcut(nn.Module):
    """Dense layers and, beside them, a linear function of what they see, zero at first."""

    def __init__(self, layers: nn.Sequential) -> None:
        super().__init__()
        self.layers = layers
        self.linear = nn.Linear(layers[0].in_features, layers[-1].out_features, bias=False)
        nn.init.zeros_(self.linear.weight)

    def forward(self, x: Tensor) -> Tensor:
        return self.layers(x) + self.linear(x)


class Value(nn.Module):
    """The return that follows from a normalised observation (..., o): (...)."""

    def __init__(
        self,
        sizes: Sequence[int],
        *,
        activation: str = "tanh",
        gain: float = GAIN,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        self.network = network((*sizes, 1), activation, gain=gain).to(dtype)

    def forward(self, x: Tensor) -> Tensor:
        return self.network(x.to(self.network[0].weight.dtype))[..., 0]


def network(
    sizes: Sequence[int], activation: str, last: float = 1.0, gain: float = GAIN
) -> nn.Sequential:
    """Dense layers with orthogonal weights of this gain, and `last` in the last; no activation
    after that.
    """
    layers: list[nn.Module] = []
    for i, (a, b) in enumerate(pairwise(sizes)):
        layer = nn.Linear(a, b)
        nn.init.orthogonal_(layer.weight, last if i == len(sizes) - 2 else gain)
        nn.init.zeros_(layer.bias)
        layers += [layer, ACTIVATIONS[activation]()]
    return nn.Sequential(*layers[:-1])


def save(policy: Policy, path: str | Path, **about: Any) -> None:
    """Write the policy and what is to be known about it: plain numbers, texts, lists and dicts of
    them.
    """
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    save_file(path, {"shape": policy.shape, "weights": policy.state_dict(), "about": about})


def is_plain(value: Any) -> bool:
    """Whether `read` gives it back: numbers, texts, tensors, lists and dicts of them."""
    if isinstance(value, dict):
        return all(map(is_plain, (*value.keys(), *value.values())))
    if isinstance(value, list | tuple):
        return all(map(is_plain, value))
    return value is None or type(value) in (bool, int, float, str) or isinstance(value, Tensor)


def load(path: str | Path) -> Policy:
    """A policy from its file; `.about` is what was saved beside it."""
    content = read(path, "policy", ("shape", "weights", "about"))
    try:
        policy = Policy(**content["shape"], dtype=content["weights"]["log_deviation"].dtype)
        policy.load_state_dict(content["weights"])
    except (KeyError, TypeError, AttributeError, RuntimeError, ValueError, IndexError):
        raise ValueError(
            f"the file {str(path)!r} was given, whose weights fit no policy of this release; "
            "another is wanted"
        ) from None
    policy.about = content["about"]
    return policy


def read(path: str | Path, what: str, keys: Sequence[str]) -> dict[str, Any]:
    """A file of tensors, numbers, texts, lists and dicts, with these keys at its top. Nothing in it
    is ever run.

    Raises ValueError for any other file, an old, damaged or malicious one among them.
    """
    try:
        content = torch.load(path, weights_only=True)
    except FileNotFoundError:
        raise ValueError(
            f"the file {str(path)!r} was given for a {what}, and is not there"
        ) from None
    except Exception as error:  # of a file of something else torch.load may raise anything
        why = (
            "holds more than tensors and plain data"
            if isinstance(error, pickle.UnpicklingError)
            else "cannot be read"
        )
        raise ValueError(
            f"the file {str(path)!r} was given for a {what}, and {why}: it is damaged, of another "
            "release or none of this package's"
        ) from None
    if not isinstance(content, dict) or not set(keys) <= content.keys():
        raise ValueError(
            f"the file {str(path)!r} was given for a {what}, and has no {', '.join(keys)}; "
            "another is wanted"
        )
    return content
