"""Sentences on what a search observed."""

from __future__ import annotations

import math
from collections.abc import Iterator

from .law import LEAST_ORDER
from .search import Checked, Search
from .setting import ELEMENTS, METHODS

SLOW = 0.65  # share of an order below which it is worth a sentence


def notes(search: Search, best: Checked) -> Iterator[str]:
    """What of the chosen setting's errors is not as in smooth motion, what was refused, and, where
    the wanted error was not reached, what would be needed.
    """
    setting = best.setting
    mesh, steps = (
        None if name not in laws else laws[name].order()
        for laws, name in ((search.space, setting.element), (search.time, setting.method))
    )
    if mesh is not None and not mesh >= SLOW * ELEMENTS[setting.element].rate:
        yield (
            f"The error of meshes was seen to fall with h^{mesh:.2g}, where {setting.element} "
            f"elements have order {ELEMENTS[setting.element].rate:g}: not yet the asymptotic "
            "range, or the quantity is not smooth along the beam."
        )
    if steps is not None and not steps >= SLOW * METHODS[setting.method].rate:
        yield (
            f"The error of the steps falls with h^{steps:.2g}, where {setting.method} has order "
            f"{METHODS[setting.method].rate:g}: not yet its asymptotic range, or something acts "
            "suddenly, and what oscillates faster than the step has a wrong phase."
        )
    for name, sentence in search.refused.items():
        yield f"Without {name}{' elements' * (name in ELEMENTS)}: {sentence}"
    if best.error <= search.rtol:
        return
    yield f"The error {best.error:.2g} is more than the {search.rtol:g} that were wanted."
    half = search.rtol / 2
    count = None if setting.step is None else search.trials.step_count(setting.step)
    both = (
        ("elements", best.space, mesh, setting.elements, search.most[0]),
        ("steps", best.time, steps, count, search.most[1]),
    )
    for what, error, order, fineness, most in both:
        if fineness is None or error <= half:
            continue
        if error == math.inf:
            yield f"Runs by more {what} failed."
        elif order is not None and not order > LEAST_ORDER:
            yield (
                f"More {what} hardly change it: the quantity does not converge here. A sudden load "
                "of an undamped beam moves all its modes, velocities and strains most of all; "
                "damping, a load that takes some time to come, or a mean in place of a value at a "
                "point would make it converge."
            )
        else:
            wanted = fineness * (error / half) ** (1 / (order or 2.0))
            yield (
                f"By the order observed about {wanted:.2g} {what} are wanted; at most {most} are "
                f"allowed, in {search.trials.seconds:g} s of CPU time."
            )
