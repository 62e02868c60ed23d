"""Parameters of the beam that may change with the episode: ranges, random draws, checks of given
values.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchbeam.extend import shown, warn

BEYOND = 10.0  # of a documented range: numbers that are all beyond it by as much are of other units


@dataclass(frozen=True)
class Parameter:
    """A number that may change with the episode.

    Args:
        value: its usual value
        low, high: the range that randomize=True draws from; if they are equal it does not vary
        least: smallest value
        above: whether it must exceed `least`

    Examples:
        >>> payload = envs.Parameter(0.1, low=0.05, high=0.15, above=True)  # kg
        >>> payload.check("payload", [0.06, 0.2])  # ValueError for a value that is not above 0
        >>> env = envs.PayloadVectorEnv(2, elements=2, randomize={"payload": (0.06, 0.2)})
        >>> observation, _ = env.reset(seed=0)
        >>> ((env.state.plant.params["payload"] - 0.13).abs() < 0.07).all()
        tensor(True)
    """

    value: float
    low: float
    high: float
    least: float = 0.0
    above: bool = False

    def __post_init__(self) -> None:
        for name in ("value", "low", "high", "least"):
            one = numbers(name, getattr(self, name))
            if one.ndim or np.isnan(one):
                given = shown(getattr(self, name))
                raise ValueError(f"{name} = {given} was given; one number is wanted")
        if not isinstance(self.above, (bool, np.bool_)):
            raise ValueError(f"above = {shown(self.above)} was given; True or False is wanted")

    def check(self, name: str, value: Any) -> None:
        """ValueError where one of the values is no number, out of bounds, infinite or NaN."""
        values = numbers(name, value)
        if not (
            np.isfinite(values) & ((values > self.least) if self.above else (values >= self.least))
        ).all():
            raise ValueError(f"{name} = {values.tolist()} was given; {self._wanted} is wanted")

    @property
    def _wanted(self) -> str:
        if self.least == -math.inf:
            return "a finite number"
        return f"a finite number {'above' if self.above else 'of at least'} {self.least:g}"


class Parameters(dict[str, Parameter]):
    """Parameters that may change with the episode, by name; ValueError for another name or a value
    out of range.
    """

    def named(self, name: Any) -> Parameter:
        if name not in self:
            wanted = f"there are {', '.join(self)}" if self else "this form of the beam has none"
            raise ValueError(f"the parameter {shown(name)} was given; {wanted}")
        return self[name]

    def ranges(
        self, randomize: bool | Mapping[str, Sequence[float]] | None
    ) -> dict[str, tuple[float, float]]:
        """name -> (low, high) of what is drawn at each reset, in the order of the names here. Warns
        of numbers far beyond a documented range.
        """
        if randomize is True:
            drawn = {name: (p.low, p.high) for name, p in self.items() if p.low < p.high}
            if not drawn:
                raise ValueError(
                    "randomize = True was given; this form of the beam has no parameters that it "
                    "draws: a dictionary of (low, high) by name is wanted"
                )
            return drawn
        randomize = randomize or {}
        for name, bounds in randomize.items():
            self.named(name).check(name, bounds)
            if np.shape(bounds) != (2,) or bounds[0] > bounds[1]:
                raise ValueError(
                    f"randomize = {{{shown(name)}: {shown(bounds)}}} was given; (low, high) is "
                    "wanted"
                )
            usual = self[name]
            beyond = bounds[0] > BEYOND * usual.high or bounds[1] < usual.low / BEYOND
            if usual.low < usual.high and 0 <= usual.low and beyond:
                warn(
                    f"randomize = {{{shown(name)}: {shown(bounds)}}} was given, where the "
                    f"documented range is ({usual.low:g}, {usual.high:g}); numbers of that kind "
                    "are wanted",
                    UserWarning,
                )
        return {name: tuple(map(float, randomize[name])) for name in self if name in randomize}

    def given(self, params: Any, count: int, like: Tensor) -> dict[str, Tensor]:
        """name -> (count,), from a mapping of names to one number or one for each sub-env; tensors
        keep their gradient.
        """
        if params is None:
            return {}
        if not isinstance(params, Mapping):
            raise ValueError(
                f"params = {shown(params)} was given; a dictionary of parameters by name is wanted"
            )
        return {name: self._given(name, value, count, like) for name, value in params.items()}

    def _given(self, name: Any, value: Any, count: int, like: Tensor) -> Tensor:
        parameter = self.named(name)
        if not isinstance(value, Tensor):
            value = numbers(name, value)
        value = torch.as_tensor(value, dtype=like.dtype, device=like.device)
        if value.shape not in ((), (count,)):
            raise ValueError(
                f"{name} of shape {tuple(value.shape)} was given; one number or {count} are wanted"
            )
        parameter.check(name, value)
        return value.expand(count)


def numbers(name: str, value: Any) -> np.ndarray:
    """Real numbers as a float64 array; ValueError for anything else."""
    try:
        array = np.asarray(value.detach().cpu() if isinstance(value, Tensor) else value)
    except Exception:  # of a class of the user's, too
        array = np.asarray(None)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{name} = {shown(value)} was given; real numbers are wanted")
    return array.astype(np.float64)
