"""Nuisance: linear parameters of instruments: offsets, drifts, baselines, hums."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ...core.arguments import function as check_function
from ...core.validation import as_tensor, finite
from .measurement import Measurement


@dataclass(frozen=True)
class Nuisance:
    """How linear parameters of measurements enter n readings.

    names  (q,);  place (q,) of each among all parameters theta;  rows (q, n), by which they enter
    times  (n,) s;  wave (w,) of the rows, those that are where a wave enters, in place of how;
           frequency (w,) place of the parameter, Hz, that it has; late (w,) of a turn: 0 of a
           cosine, 1/4 of a sine
    """

    names: tuple[str, ...]
    place: Tensor
    rows: Tensor
    times: Tensor
    wave: Tensor
    frequency: Tensor
    late: Tensor

    @classmethod
    def of(cls, every: Sequence[tuple[str | None, Measurement]], first: int) -> Nuisance:
        """Of measurements, each with its experiment's name, in a row; the parameters' places from
        `first` on. Waves have none for their frequencies yet, see `with_frequencies`.
        """
        names, rows, times, wave, late = [], [], [], [], []
        sizes = [m.values.numel() for _, m in every]
        for k, (experiment, m) in enumerate(every):
            around = sum(sizes[:k]), sum(sizes[k + 1 :])
            for label, row, phase in _terms(m):
                if phase is not None:
                    wave.append(len(rows))
                    late.append(phase)
                names.append(label if experiment is None else f"{experiment}.{label}")
                rows.append(torch.nn.functional.pad(row, around))
            at = torch.zeros_like(m.values)
            if m.times is not None:
                at = at + m.times.reshape(-1, *(1,) * (m.values.ndim - 1))
            times.append(at.flatten())
        like = every[0][1].values
        places = first + torch.arange(len(rows), device=like.device)
        none = torch.zeros(len(wave), dtype=torch.long, device=like.device)
        return cls(
            tuple(names),
            places,
            torch.stack(rows) if rows else like.new_zeros(0, sum(sizes)),
            torch.cat(times),
            none.new_tensor(wave),
            none,
            like.new_tensor(late),
        )

    def with_frequencies(self, places: Iterable[int]) -> Nuisance:
        """With the places (w,) of the waves' frequencies."""
        return replace(self, frequency=self.wave.new_tensor([*places]))

    def longer(self, count: int) -> Nuisance:
        """With so many readings more, in which none is."""
        pad = torch.nn.functional.pad
        return replace(self, rows=pad(self.rows, (0, count)), times=pad(self.times, (0, count)))

    def basis(self, theta: Tensor, rate: bool = False) -> Tensor:
        """(N or 1, q, n) by which they enter at theta (N, p); or how that of waves changes by their
        frequencies (N, w, n).
        """
        if not len(self.wave):
            return self.rows[None]
        turns = theta[:, self.frequency, None] * self.times - self.late[:, None]
        angle, own = 2 * math.pi * turns, self.rows[self.wave]
        if rate:
            return -2 * math.pi * self.times * own * torch.sin(angle)
        rows = self.rows.expand(len(theta), -1, -1)
        return rows.index_copy(1, self.wave, own * torch.cos(angle))

    def values(self, theta: Tensor) -> Tensor:
        """(N, n) what they add to the readings at theta (N, p)."""
        return (theta[:, None, self.place] @ self.basis(theta))[:, 0]

    def derivatives(self, theta: Tensor) -> Tensor:
        """(N, p, n) of these values by theta (N, p)."""
        by = theta.new_zeros(*theta.shape, self.rows.shape[-1])
        by[:, self.place] = self.basis(theta)
        if len(self.wave):
            own = theta[:, self.place[self.wave], None] * self.basis(theta, rate=True)
            by.index_add_(1, self.frequency, own)
        return by


def wave_names(m: Measurement) -> list[str]:
    """Name of the frequency of each wave of a measurement, in the order of `Nuisance`."""
    return [h for h in m.hum if isinstance(h, str) for _ in range(2 * len(m.labels))]


def _terms(m: Measurement) -> Iterator[tuple[str, Tensor, float | None]]:
    """Name, row (numbers,) and, of a wave whose frequency is a parameter, its lag in turns, of each
    linear parameter of a measurement.
    """
    along = m.times
    if along is None:
        n = len(m.values) if m.values.ndim else 1
        along = torch.linspace(0, 1, n, dtype=m.values.dtype).to(m.values)
    shapes: list[tuple[str, Tensor, float | None]] = []
    for name, shape in (("offset", torch.ones_like(along)), ("drift", along)):
        if getattr(m, name):
            shapes.append((name, shape, None))
    slow = _slow(m, along).unbind(-1)
    several = len(slow) > 1
    shapes += [(f"baseline[{k}]" if several else "baseline", s, None) for k, s in enumerate(slow)]
    for hum in m.hum:
        for name, late in (("cosine", 0.0), ("sine", 0.25)):
            if isinstance(hum, str):
                shapes.append((f"{name} of {hum}", torch.ones_like(along), late))
            else:
                wave = torch.cos(2 * math.pi * (hum * along - late))
                shapes.append((f"{name} of {hum:g} Hz", wave, None))
    for name, shape, late in shapes:
        for k, label in enumerate(m.labels):
            column = torch.zeros(len(along), len(m.labels)).to(m.values)
            column[:, k] = shape
            yield f"{name} of {label}" if label else name, column.flatten(), late


def _slow(m: Measurement, along: Tensor) -> Tensor:
    """(times, k) of its baseline."""
    if m.baseline is None:
        return along.new_zeros(len(along), 0)
    slow = as_tensor(check_function("baseline", m.baseline, "times")(along), along.dtype)
    if slow.shape[:1] != along.shape or slow.ndim > 2:
        raise ValueError(
            f"a baseline of shape {tuple(slow.shape)} was given for times of shape "
            f"{tuple(along.shape)}; the same, or (times, k), is wanted"
        )
    return finite("baseline", slow).reshape(len(along), -1)
