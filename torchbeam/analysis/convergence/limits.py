"""Limits of a search for the cheapest setting."""

from __future__ import annotations

from typing import NamedTuple

from ...core.arguments import choice, listed, number
from ...core.arguments import count as check_count
from ...core.arguments import level_of as check_level
from ...core.arguments import tolerance as check_tolerance
from .setting import ELEMENTS, METHODS


class Limits(NamedTuple):
    """Limits of a search.

    Args:
        share: of a batch's samples whose error is to be that small; all share one setting
        elements, methods: that may be chosen: "linear", "linked", "order 2"; "midpoint",
            "midpoint4", "generalized_alpha"
        most_elements, most_steps: beyond which nothing is chosen
        seconds: of CPU time, which all runs together are not to exceed
    """

    share: float
    elements: list[str]
    methods: list[str]
    most_elements: int
    most_steps: int
    seconds: float

    def checked(self) -> Limits:
        """With each name once. Raises ValueError for what is none of these."""
        if number("share", self.share) != 1:
            check_level("share", self.share)
        for name, known in (("elements", ELEMENTS), ("methods", METHODS)):
            for each in listed(getattr(self, name)) or (None,):
                choice(f"one of {name}", each, known)
        check_count("most_elements", self.most_elements, 4)
        check_count("most_steps", self.most_steps, 2)
        check_tolerance("seconds", self.seconds)
        elements, methods = (list(dict.fromkeys(listed(x))) for x in (self.elements, self.methods))
        return self._replace(
            share=float(self.share), elements=elements, methods=methods, seconds=float(self.seconds)
        )
