"""Slots of steps, see `driver`: what is before and behind the iterations of each."""

from __future__ import annotations

from .driver import Slots
from .interaction_sorts import ENDS
from .method_functions import ENERGIES
from .sorts import NODE, Row


class StepSlots(Slots):
    """Steps of Newton's method."""

    def begin(self) -> None:
        driver = self.driver
        driver.each_row(NODE, lambda row: driver.call_of("predictor", row, "unknown"))
        driver.hoisted()
        driver.start()
        for name in ("over", "done"):
            moving = driver.at("sample", 0, "moving")
            self.code.call("opposite", driver.at("sample", 0, name), moving)
        driver.border()

    def finish(self) -> None:
        driver = self.driver
        self._outcome()
        good = driver.at("sample", 0, "good")
        self._begin_work()
        if driver.has_energy:
            driver.fill(("energy", 0))
        driver.tensions.find()
        for sort in ENDS:
            driver.each_of(sort, lambda row: self._end(row, good), look=True)
        driver.tensions.read(good)
        driver.over_cells("sum", driver.at("sample", 0, "work"))
        if driver.has_energy:
            self._project(good)
        driver.keep_forces(good)

    def _outcome(self) -> None:
        """Which samples have gone well."""
        driver = self.driver
        with self.code.loop(0, driver.args["nodes"]) as j:
            driver.call("cosine", lambda f: driver.at("unknown", j, f), ("change", 0))
            driver.least_cosine(j)
        driver.over_cells("least", driver.at("sample", 0, "cosine"))
        places = {
            "before": ("sample", 0, "last_status"),
            "> status": ("sample", 0, "found_status"),
            "> moving": ("sample", 0, "good"),
        }
        records = "common", "sums", "sample"
        driver.call("outcome", lambda f: driver.first_of(records, f), places=places)
        for name, source in (("last_status", "found_status"), ("moving", "good")):
            driver.copy(("sample", 0, name), ("sample", 0, source))

    def _end(self, row: Row, good: str) -> None:
        """What a state has of a row after the step, of what has gone well, its work and its
        energies.
        """
        driver, word = self.driver, f"finish {row.name}"
        outputs = driver.outputs_of(word, row)
        if not outputs:
            return
        driver.call_of(word, row, "change")
        for name in driver.layout.fields(row.of.state):
            driver.take((row.of.state, row.number, name), ("change", 0, name), good)
        if row.own is not None:
            driver.take(("multiplier_state", row.own, "last_force"), ("change", 0, "force"), good)
        if "work" in outputs:
            counted = self._counted(row, good)
            driver.add_where(("sample", 0, "work"), ("change", 0, "work"), counted)
        for name in ENERGIES if driver.has_energy else ():
            if name in outputs:
                driver.add(("energy", 0, name), ("change", 0, name))

    def _counted(self, row: Row, good: str) -> str:
        """What has gone well, in whose lanes a row counts: what cells share counts in the first of
        them alone.
        """
        driver, own = self.driver, row.of.shared
        if driver.cells == 1 or own is None:
            return good
        shared = self.code.compare("sge", row.number, driver.args[own])
        return self.code.choose(shared, driver.at("sample", 0, "counted"), good, "ptr")

    def _begin_work(self) -> None:
        """What there is of it, and what cells share, counts in the lane of the first."""
        driver = self.driver
        if driver.cells > 1:
            work, good = driver.at("sample", 0, "work"), driver.at("sample", 0, "good")
            self.code.call("first cell", work, work)
            self.code.call("first cell", driver.at("sample", 0, "counted"), good)

    def _project(self, good: str) -> None:
        """Scale the velocities of the step's end."""
        driver = self.driver
        places = {"> scale": ("energy", 0, "scale"), "> defect": ("change", 0, "defect")}
        driver.call("project", lambda f: driver.first_of(("energy", "sample"), f), places=places)
        driver.take(("sample", 0, "defect"), ("change", 0, "defect"), good)
        with self.code.loop(0, driver.args["nodes"]) as j:
            places = {"scale": ("energy", 0, "scale")}
            driver.call("scaled", lambda f: driver.at(NODE.state, j, f), ("change", 0), places)
            for name in ("velocity", "spin"):
                driver.take((NODE.state, j, name), ("change", 0, name), good)
