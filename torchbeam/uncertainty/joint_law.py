"""Joint law of all parameters: laws by name, correlated by a Gaussian copula."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import number
from ..core.validation import converted, finite, refusal, shown
from ..math.distributions import normal_score
from .given_law import checked, of_uniform
from .law_scores import has_tails, of_score
from .laws import Constant, Law

PLACES, LITTLE = 15, 1e-4  # where laws are looked at for steps, and a change of a normal score
Correlation = Any  # (p, p) over the laws in their order, or {("EI", "mass"): 0.5}


@dataclass(frozen=True)
class JointLaw:
    """Laws by name, in the order of theta's columns, and the correlation of their normal scores.

    correlation  (p, p), unit diagonal, positive definite, or None: independent. The score of a
                 parameter is the standard normal variable of the same probability, z = ndtri(F(x));
                 all scores together are normal (Nataf 1962). Spearman's rank correlation is then
                 6/pi asin(correlation/2)

    A sample is made of `dimension` variates: u uniform in (0, 1) or z normal, one for each law,
    none for a `Constant`, several for a `RandomField`.
    """

    laws: dict[str, Law]
    correlation: Tensor | None = None

    @classmethod
    def of(cls, laws: Any, correlation: Correlation = None) -> JointLaw:
        """From what a user gives; ValueError for no dict of laws, or no correlation of them."""
        if not isinstance(laws, Mapping):
            raise refusal(f"laws = {shown(laws)}", "a dict, name -> law,")
        if not laws:
            raise refusal("no laws", "one for each parameter", were=True)
        laws = {name: checked(name, law) for name, law in laws.items()}
        return cls(laws, None if correlation is None else _correlation(correlation, laws))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of theta's columns; of a field, with the number of the place."""
        return tuple(
            name if size is None else f"{name}[{k}]"
            for name, size in self.sizes.items()
            for k in range(size or 1)
        )

    @cached_property
    def sizes(self) -> dict[str, int | None]:
        """Columns of each law; None = one number."""
        return {
            name: getattr(law, "size", None) if hasattr(law, "of_scores") else None
            for name, law in self.laws.items()
        }

    @cached_property
    def dimensions(self) -> dict[str, int]:
        """Variates that each law takes."""
        return {
            name: law.dimension if hasattr(law, "of_scores") else int(not isinstance(law, Constant))
            for name, law in self.laws.items()
        }

    @property
    def dimension(self) -> int:
        return sum(self.dimensions.values())

    def random(self) -> dict[str, int]:
        """Variates of each law that is random; ValueError where none is."""
        random = {name: size for name, size in self.dimensions.items() if size}
        if not random:
            raise refusal("laws that are all constant", "one that is random", were=True)
        return random

    def of_uniform(self, u: Tensor) -> Tensor:
        """theta (N, columns), float64, of u (N, dimension)."""
        if self.correlation is not None:
            return self.of_score(normal_score(u))
        return self._columns(u, of_uniform, lambda part: normal_score(part))

    def of_score(self, z: Tensor) -> Tensor:
        """theta (N, columns), float64, of independent normal scores z (N, dimension)."""
        return self._columns(torch.cat(self._scores(z), -1), of_score, lambda part: part)

    @property
    def without_tails(self) -> list[str]:
        """Names of laws that tell values of probabilities alone, and so not the far upper tail."""
        return [name for name, law in self.laws.items() if self._mixes(law) and not has_tails(law)]

    @property
    def in_steps(self) -> list[str]:
        """Names of random laws whose values stay where their scores change a little, as observed
        values do: at most places that are drawn.
        """
        draw = torch.Generator().manual_seed(0)
        z = torch.randn(PLACES, self.dimension, generator=draw, dtype=torch.float64)
        a, b = (self.named(self.of_score(scores)) for scores in (z, z + LITTLE))
        return [
            name
            for name in self.random()
            if (a[name] == b[name]).reshape(PLACES, -1).all(-1).sum() > PLACES / 2
        ]

    def _scores(self, z: Tensor) -> list[Tensor]:
        """Normal scores of each law, (N, variates), of independent ones z (N, dimension)."""
        scores = list(z.split(list(self.dimensions.values()), -1))
        mixed = [k for k, law in enumerate(self.laws.values()) if self._mixes(law)]
        if self.correlation is None or not mixed:
            return scores
        root = torch.linalg.cholesky(self.correlation[mixed][:, mixed])
        for k, column in zip(
            mixed, (torch.cat([scores[k] for k in mixed], -1) @ root.mT).split(1, -1), strict=True
        ):
            scores[k] = column
        return scores

    def named(self, theta: Tensor) -> dict[str, Tensor]:
        """Columns by the names of laws: (N,), of a field (N, places)."""
        parts = theta.split([size or 1 for size in self.sizes.values()], -1)
        return {
            name: part if size is not None else part[:, 0]
            for (name, size), part in zip(self.sizes.items(), parts, strict=True)
        }

    def _columns(self, v: Tensor, one: Any, scores: Any) -> Tensor:
        columns = []
        for (name, law), part in zip(
            self.laws.items(), v.split(list(self.dimensions.values()), -1), strict=True
        ):
            if hasattr(law, "of_scores"):
                column, wanted = law.of_scores(scores(part)), (len(v), law.size)
            elif isinstance(law, Constant):
                column, wanted = v.new_zeros(len(v)) + law.value, (len(v),)
            else:
                column, wanted = one(law, part[:, 0]), (len(v),)
            wrong = None
            if not isinstance(column, Tensor):
                wrong = f"a {type(column).__name__}"
            elif column.shape != wanted:
                wrong = f"{tuple(column.shape)}"
            elif not torch.isfinite(column).all():
                wrong = "numbers that are not finite"
            if wrong:
                raise ValueError(
                    f"a law of {name!r} that gave {wrong} for u ({len(v)},) was given; finite "
                    f"numbers ({', '.join(map(str, wanted))},) are wanted"
                    if len(wanted) == 1
                    else (
                        f"a field of {name!r} that gave {wrong} was given; finite numbers "
                        f"{wanted} are wanted"
                    )
                )
            columns.append(column.cpu().double().reshape(len(v), -1))
        return torch.cat(columns, -1)

    @staticmethod
    def _mixes(law: Law) -> bool:
        """Whether a law takes part in the copula: one of one number, that is random."""
        return not isinstance(law, Constant) and not hasattr(law, "of_scores")


def _correlation(correlation: Correlation, laws: dict[str, Law]) -> Tensor:
    """(p, p) float64; ValueError for what is no correlation of these laws."""
    names = list(laws)
    p = len(names)
    if isinstance(correlation, Mapping):
        matrix = torch.eye(p, dtype=torch.float64)
        for pair, value in correlation.items():
            if (
                not isinstance(pair, tuple)
                or len(pair) != 2
                or any(law not in names for law in pair)
                or pair[0] == pair[1]
            ):
                raise refusal(
                    f"a correlation of {shown(pair)}", f"two of {', '.join(names)}", are=True
                )
            if pair[::-1] in correlation:
                raise ValueError(
                    f"a correlation of {pair!r} and one of {pair[::-1]!r} were given; one of the "
                    "two is wanted"
                )
            i, j = map(names.index, pair)
            matrix[i, j] = matrix[j, i] = number(f"the correlation of {pair!r}", value)
    else:
        matrix = converted(correlation, torch.float64).cpu()
    finite("correlation", matrix)
    if matrix.shape != (p, p):
        raise ValueError(
            f"a correlation {tuple(matrix.shape)} was given for {p} laws; ({p}, {p}) is wanted"
        )
    if (matrix - matrix.mT).abs().max() > 1e-12 or (matrix.diagonal() - 1).abs().max() > 1e-12:
        raise ValueError(
            "a correlation that is not symmetric, or whose diagonal is not 1, was given"
        )
    least = torch.linalg.eigvalsh(matrix)[0].item()
    if least <= 1e-12:
        raise refusal(
            f"a correlation with the eigenvalue {least:.3g}", "a positive definite matrix"
        )
    for k, (name, law) in enumerate(laws.items()):
        if not JointLaw._mixes(law) and (matrix[k].abs().sum() > 1):
            kind = "constant" if isinstance(law, Constant) else "random field"
            raise ValueError(
                f"a correlation of {name!r} was given, which is a {kind}; only random laws of "
                "one number have one"
            )
    return (matrix + matrix.mT) / 2
