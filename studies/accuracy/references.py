"""References by refinement: each motion by two settings, and how far they agree. They share neither
element nor method; where order is lost (see docs/accuracy.md) they share the method, for a
second-order one is out of reach, and not its steps.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from torchbeam import simulate
from torchbeam.extend.commands import write as write_file

from ..common_case import difference
from ..harness import data
from .motions import INTERVALS, MOTIONS, PARAMETERS, Motion

FILE = "accuracy_references"
LOSS = 10  # instants that the loss is a mean over
ABOUT = (
    "Tips (m, rounded to 1e-10 of the length) of the motions of "
    "studies.accuracy.motions at equally spaced instants, and the gradient of the loss "
    "(studies.accuracy.references.loss) by multipliers of {parameters}. By the first of "
    "two settings; agreement: RMS distance of the two over RMS displacement, and of the two "
    "gradients over the gradient. `python -m studies accuracy --references FILE` writes this "
    "file."
)


class Fine(NamedTuple):
    """An element, its numbers of elements, a method, its numbers of steps; two of a kind, the
    second twice the first: the limit that they tell, by the order of the element in its length, and
    the second in the step.
    """

    element: str
    elements: tuple[int, ...]
    method: str
    steps: tuple[int, ...]

    def __str__(self) -> str:
        def said(counts: tuple[int, ...], noun: str) -> str:
            return (
                f"{' and '.join(map(str, counts))} "
                f"{noun}{', extrapolated' if len(counts) > 1 else ''}"
            )

        return (
            f"{said(self.elements, f'{self.element} elements')}; "
            f"{said(self.steps, f'steps by {self.method}')}"
        )


# fmt: off
SETTINGS = {
    "sudden": (Fine("order 2", (48,), "midpoint4", (60_000,)),
               Fine("linked", (192,), "midpoint4", (40_000,))),
    "coupled": (Fine("linear", (64, 128), "midpoint4", (1800,)),
                Fine("order 2", (16, 32), "midpoint", (1800, 3600))),
    "follower": (Fine("linear", (64, 128), "midpoint4", (1800,)),
                 Fine("order 2", (16, 32), "midpoint", (1800, 3600))),
    "silicone": (Fine("linear", (64, 128), "midpoint4", (2400,)),
                 Fine("order 2", (16, 32), "midpoint", (3600, 7200))),
    "spin-up": (Fine("linear", (64, 128), "midpoint4", (6000,)),
                Fine("order 2", (16, 32), "midpoint", (9600, 19_200))),
}
# fmt: on


class Reference(NamedTuple):
    """tip (INTERVALS + 1, 3) m at `Motion.instants()`, gradient (3,) of the loss; agreement of two
    settings for both.
    """

    tip: Tensor
    gradient: Tensor
    agreement: float
    gradient_agreement: float


def loss(motion: Motion, tip: Tensor) -> Tensor:
    """Mean of the squared distances of the tip (time, ..., 3) from its start over the square of the
    length, at ten equally spaced instants, the last of them the end; (...).
    """
    every = (len(tip) - 1) // LOSS
    return ((tip[every::every] - tip[0].detach()) / motion.length).square().sum(-1).mean(0)


def differentiated(motion: Motion, run: Callable[[Tensor], Tensor]) -> tuple[Tensor, Tensor]:
    """The tip, without its graph, that run(by) gives, and the gradient (3,) of its loss by the
    multipliers `by`, at 1.
    """
    by = torch.ones(3, dtype=torch.float64, requires_grad=True)
    tip = run(by)
    (gradient,) = torch.autograd.grad(loss(motion, tip), by)
    return tip.detach(), gradient


def apart(gradient: Tensor, reference: Tensor) -> float:
    """|gradient - reference| / |reference|."""
    return ((gradient - reference).norm() / reference.norm()).item()


def load() -> dict[str, Reference]:
    """Of all motions, by name."""
    return {
        name: Reference(
            *(torch.tensor(one[key], dtype=torch.float64) for key in ("tip", "gradient")),
            one["agreement"],
            one["gradient agreement"],
        )
        for name, one in data(FILE)["references"].items()
    }


def write(path: Path, settings: dict[str, tuple[Fine, Fine]] | None = None) -> Iterator[str]:
    """The file of references, made anew; a sentence on each."""
    references = {}
    for motion in MOTIONS:
        if motion.reference != motion.name or motion.name not in (settings or SETTINGS):
            continue
        fine = (settings or SETTINGS)[motion.name]
        (tip, gradient), (other, other_gradient) = (_limit(motion, one) for one in fine)
        agreement, of_gradients = difference(other, tip), apart(other_gradient, gradient)
        scale = motion.length
        references[motion.name] = {
            "settings": [str(one) for one in fine],
            "agreement": agreement,
            "gradient agreement": of_gradients,
            "gradient": gradient.tolist(),
            "tip": [[round(x / scale, 10) * scale for x in row] for row in tip.tolist()],
        }
        yield f"{motion.name}: agree to {agreement:.1e}, gradients to {of_gradients:.1e}"
    content = {
        "about": ABOUT.format(parameters=", ".join(PARAMETERS)),
        "intervals": INTERVALS,
        "references": references,
    }
    write_file(path, json.dumps(content, separators=(",", ":")).replace('],"', '],\n"') + "\n")


def _limit(motion: Motion, fine: Fine) -> tuple[Tensor, Tensor]:
    """Tip and gradient of a fine setting, extrapolated in both."""
    order = 4 if fine.element == "order 2" else 2
    ends = [
        [_motion(motion, fine.element, elements, fine.method, steps) for steps in fine.steps]
        for elements in fine.elements
    ]
    return tuple(
        _extrapolated([_extrapolated([run[k] for run in runs], 2) for runs in ends], order)
        for k in range(2)
    )


def _extrapolated(values: list[Tensor], order: int) -> Tensor:
    """The limit of two values whose error is of an order, the second of half the size; or the one
    there is.
    """
    return values[-1] + (values[-1] - values[-2]) / (2**order - 1) if len(values) > 1 else values[0]


def _motion(
    motion: Motion, element: str, elements: int, method: str, steps: int
) -> tuple[Tensor, Tensor]:
    return differentiated(
        motion,
        lambda by: (
            simulate(
                motion.scene(element, elements, by, flat=True),
                motion.instants(),
                method=method,
                step=motion.duration / steps,
                checkpoint=True,
                throw=True,
            ).tip.position
        ),
    )
