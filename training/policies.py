"""Policies and value functions: small networks behind a running normalisation of what they see, and
their files.

from training.policies import load
policy = load("training/policies/reach-shac.pt")
action = policy(observation)                      # numpy or torch, (..., o) -> (..., a)
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import softplus

from torchbeam.extend.commands import save as save_file

ACTIVATIONS = {"tanh": nn.Tanh, "elu": nn.ELU}
GAIN = 2**0.5  # of hidden layers
LOG_DEVIATIONS = (-5.0, 1.0)  # bounds, where a network has them
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
    """A normal distribution of actions: its mean from a network of the features, one deviation an
    action. Features (..., o + m) are the normalised observation and, with a memory, what a
    recurrent unit (GRU, Cho et al. 2014) makes of all observations of the episode.

    sizes       (o, hidden ..., a)
    squash      True: actions are tanh of the normal ones (smooth at the bounds: for gradients
                through the environment). False: they are clipped by the environment (the density
                stays that of the normal: for likelihood ratios)
    deviation   of the normal at the start
    linear      whether the network has a linear `Shortcut`: most of what linear controllers teach
    gain        of the hidden layers' orthogonal weights at the start
    memory      m, units of the recurrent unit; 0 = none

    Calling it gives the most likely action, numpy for numpy and torch for torch, without noise,
    within [-1, 1]. With a memory, `begin(env)` is wanted after a reset, as of a controller, and
    each call is the next interval.
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
        memory: int = 0,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        self.shape = dict(sizes=list(sizes), squash=squash, activation=activation, linear=linear)
        self.shape |= {"memory": memory} if memory else {}
        self.squash, self.observed, self.memory = squash, sizes[0], memory
        self.statistics = Statistics(sizes[0])
        layers = network((self.features, *sizes[1:]), activation, last=0.01, gain=gain)
        self.network = (Shortcut(layers) if linear else layers).to(dtype)
        self.log_deviation = nn.Parameter(
            torch.full((sizes[-1],), float(np.log(deviation)), dtype=dtype)
        )
        self.recurrent = nn.GRU(sizes[0], memory, dtype=dtype) if memory else None
        self.begin()

    @property
    def features(self) -> int:
        return self.observed + self.memory

    def blank(self, count: int) -> Tensor:
        """(n, m): the memory of n episodes that begin."""
        return self.log_deviation.new_zeros(count, self.memory)

    def see(self, observation: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """(features (n, o + m), memory (n, m)) once episodes with this memory (n, m) show an
        observation (n, o); differentiable.
        """
        x = self.statistics(observation).to(self.log_deviation.dtype)
        if self.recurrent is None:
            return x, memory
        _, after = self.recurrent(x[None], memory[None])
        return torch.cat((x, after[0]), -1), after[0]

    def see_all(self, observations: Tensor, memory: Tensor, over: Tensor) -> Tensor:
        """Features (T, n, o + m) of T observations (T, n, o), one after the other, from a memory
        (n, m) on; with an interval that is the last of its episode, by `over` (T, n), all is
        forgotten.
        """
        x = self.statistics(observations).to(self.log_deviation.dtype)
        if self.recurrent is None:
            return x
        ends = 1 + over[:-1].any(1).nonzero()[:, 0]
        parts = []
        for start, end in pairwise((0, *ends.tolist(), len(x))):
            part, last = self.recurrent(x[start:end], memory[None])
            parts.append(part)
            memory = torch.where(over[end - 1][:, None], 0.0, last[0])
        return torch.cat((x, torch.cat(parts)), -1)

    def see_next(self, features: Tensor, observations: Tensor) -> Tensor:
        """Features (..., o + m) once each of these observations (..., o) follows on what has these
        features (..., o + m).
        """
        memory = features[..., self.observed :].flatten(0, -2)
        after, _ = self.see(observations.flatten(0, -2), memory)
        return after.unflatten(0, features.shape[:-1])

    def held(self, features: Tensor) -> Tensor:
        """The features, for a critic: no gradient goes through their memory, which could please the
        critic and change nothing else.
        """
        x, memory = features.split((self.observed, self.memory), -1)
        return torch.cat((x, memory.detach()), -1) if self.memory else features

    def distribution(self, features: Tensor) -> torch.distributions.Normal:
        return torch.distributions.Normal(
            self.network(features), self.log_deviation.exp(), validate_args=False
        )

    def act(self, features: Tensor, noise: Tensor | None = None) -> Tensor:
        """(..., a) of features (..., o + m), differentiable; noise (..., a) standard normal."""
        x = self.network(features)
        if noise is not None:
            x = x + self.log_deviation.exp() * noise
        return torch.tanh(x) if self.squash else x

    def begin(self, env: Any = None) -> None:
        """All episodes begin. Where the env is one of `torchbeam_envs`, those that it resets later
        are begun anew by themselves; of another one, `restart` is wanted after each reset.
        """
        self.env = getattr(env, "unwrapped", env)
        self.remembered: Tensor | None = None

    def restart(self, fresh: Tensor) -> None:
        """Episodes in the mask (n,) begin; the others go on."""
        if self.remembered is not None:
            self.remembered = torch.where(fresh[:, None], 0.0, self.remembered)

    @torch.no_grad()
    def forward(self, observation: Any) -> Any:
        seen = torch.as_tensor(observation)
        if seen.shape[-1:] != (self.observed,):
            raise ValueError(
                f"observations of shape {tuple(seen.shape)} were given; (..., {self.observed}) are "
                "wanted: those of the env, with the frames, that the policy was trained on"
            )
        rows = seen.reshape(-1, seen.shape[-1])
        if self.remembered is None or not self.memory:
            self.remembered = self.blank(len(rows))
        if len(self.remembered) != len(rows):
            raise ValueError(
                f"{len(rows)} observations were given to a policy that remembers "
                f"{len(self.remembered)} episodes; as many, or begin(env) before, are wanted"
            )
        if self.memory and (episodes := getattr(self.env, "state", None)) is not None:
            self.restart(episodes.steps == 0)
        features, self.remembered = self.see(rows, self.remembered)
        action = self.act(features).to(seen.dtype).clamp(-1, 1)
        action = action.reshape(*seen.shape[:-1], action.shape[-1])
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


class Values(nn.ModuleList):
    """So many `Value` of the same sizes, each with weights of its own: (count, ...) of (..., o)."""

    def __init__(self, count: int, sizes: Sequence[int], **settings: Any) -> None:
        super().__init__(Value(sizes, **settings) for _ in range(count))

    def forward(self, x: Tensor) -> Tensor:
        return torch.stack([value(x) for value in self])


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


def squashed(mean: Tensor, deviation: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """(actions (..., a), their log-likelihood (...)): tanh of normal ones of this mean and
    deviation, by noise (..., a) that is standard normal (Haarnoja et al. 2018, appendix C).
    """
    x = mean + deviation * noise
    normal = -0.5 * noise**2 - deviation.log() - 0.5 * math.log(2 * math.pi)
    slope = 2 * (math.log(2) - x - softplus(-2 * x))  # log of the derivative of tanh
    return torch.tanh(x), (normal - slope).sum(-1)


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
