"""Native code of a search for the length of Newton's steps: the best unknowns so far, and the way
back to them; see `solvers.newton`.
"""

from __future__ import annotations

from .record_code import Places, RecordCode

SQUARES = ("square_force", "square_moment")


class Search:
    """What shortens the steps of a driver."""

    def __init__(self, driver: RecordCode) -> None:
        self.driver = driver

    @property
    def _unknowns(self) -> list[tuple[str, str, str]]:
        """Records of unknowns, of the best so far, and how many there are."""
        args = self.driver.args
        return [
            ("unknown", "best_unknown", args["nodes"]),
            ("stress", "best_stress", args["elements"]),
            *[("multiplier", "best_multiplier", args["multipliers_count"])]
            * self.driver.kinds.multiplied,
        ]

    def keep(self, worse: str) -> None:
        """The best, of samples that are below it: where they are not `worse`."""
        driver = self.driver
        for name, best, count in self._unknowns:
            with driver.code.loop(0, count) as k:
                driver.blend((best, k), (name, k), worse)

    def take_back(self) -> None:
        """Part of the way back, of samples that take it."""
        driver = self.driver
        forth = driver.at("sample", 0, "forth")
        with driver.unless_all(forth):
            for name, best, count in self._unknowns:
                with driver.code.loop(0, count) as k:
                    self._part_back(name, best, k)
                    driver.blend((name, k), (f"{name}_back", 0), forth)

    def _part_back(self, name: str, best: str, k: str) -> None:
        places: Places = {"ratio": ("sample", 0, "ratio")}
        for field in self.driver.layout.fields(name):
            places |= {field: (best, k, field), f"to_{field}": (name, k, field)}
            places[f"> {field}"] = (f"{name}_back", 0, field)
        self.driver.call(f"part {name}", places=places)
