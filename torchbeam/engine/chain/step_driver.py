"""Native driver of steps, see `driver`: what is before and behind the iterations of each."""

from __future__ import annotations

from .driver import Driver
from .interaction import FINISHED


class StepDriver(Driver):
    """Steps of Newton's method."""

    def _begin(self) -> None:
        code = self.code
        with code.loop(0, self.args["nodes"]) as j:
            self._at_node("predictor", j, ("unknown", j))
        self._hoisted()
        self._start()
        for name in ("over", "done"):
            code.call("opposite", self.at("sample", 0, name), self.at("sample", 0, "moving"))
        self._border()

    def _finish(self) -> None:
        code, records = self.code, self.layout.records
        with code.loop(0, self.args["nodes"]) as j:
            self._call("cosine", lambda f: self.at("unknown", j, f), ("change", 0))
            self._least_cosine(j)
        self._over_cells("least", self.at("sample", 0, "cosine"))
        places = {
            "before": ("sample", 0, "last_status"),
            "> status": ("sample", 0, "found_status"),
            "> moving": ("sample", 0, "good"),
        }
        own = "common", "sums", "sample"
        self._call("outcome", lambda f: self._first_of(own, f), places=places)
        for name, source in (("last_status", "found_status"), ("moving", "good")):
            self._copy_to(("sample", 0, name), ("sample", 0, source))
        good, work = self.at("sample", 0, "good"), self.at("sample", 0, "work")
        self._begin_work()
        if "energy" in records:
            self._fill(("energy", 0))
        with code.loop(0, self.args["elements"]) as e:
            self._finish_element(e, good)
        self._finish_tendons(good)
        for one in FINISHED:
            self._each_of(one, lambda entry: self._finish_interaction(entry, good), look=True)
        with code.loop(0, self.args["nodes"]) as j:
            self._at_node("finish", j, ("change", 0))
            for name in self.layout.fields("state"):
                self._take(("state", j, name), ("change", 0, name), good)
            counted = self._counted(good, j, "own_nodes")
            self._sum(work, self.at("change", 0, "work"), counted, 1)
            self._add_energies()
        self._over_cells("sum", work)
        if "energy" in records:
            self._project(good)
        self._keep_forces(good)

    def _finish_element(self, e: str, good: str) -> None:
        """Its state at the end, and the work of the loads between its nodes."""
        if "finish element 0" in self.functions:
            self._at_element("finish element", e, ("change", 0))
            for name in self.layout.fields("element_state"):
                self._take(("element_state", e, name), ("change", 0, name), good)
            self._add_energies()
        for k in self._loaded(e):
            self._add_rise(f"finish element load {k}", e)
            self._sum(("sample", 0, "work"), ("change", 0, "work"), good)

    def _begin_work(self) -> None:
        """What there is of it, and what cells share, counts in the lane of the first."""
        if self.cells > 1:
            work, good = self.at("sample", 0, "work"), self.at("sample", 0, "good")
            self.code.call("first cell", work, work)
            self.code.call("first cell", self.at("sample", 0, "counted"), good)

    def _project(self, good: str) -> None:
        """Scale the velocities of the step's end."""
        places = {"> scale": ("energy", 0, "scale"), "> defect": ("change", 0, "defect")}
        self._call("project", lambda f: self._first_of(("energy", "sample"), f), places=places)
        self._take(("sample", 0, "defect"), ("change", 0, "defect"), good)
        with self.code.loop(0, self.args["nodes"]) as j:
            places = {"scale": ("energy", 0, "scale")}
            self._call("scaled", lambda f: self.at("state", j, f), ("change", 0), places)
            for name in ("velocity", "spin"):
                self._take(("state", j, name), ("change", 0, name), good)
