"""Advice: which effects and unknowns of a scene matter for a quantity, by short trials."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import boolean, instance, listed
from ..core.arguments import count as check_count
from ..core.arguments import function as check_function
from ..core.arguments import tolerance as check_tolerance
from ..core.summary import aligned
from ..core.validation import refusal, shown
from ..dynamics.simulate import simulate
from ..scene.beam import Beam
from ..scene.effects import Effect
from ..scene.scene import Scene
from ..state.solution import Solution
from ..state.state import State

Change = Callable[[Scene], Scene]
# unknowns of [gamma; kappa] that a beam can do without
STRAINS = {"extension": (0,), "shear": (1, 2)}


@dataclass(frozen=True)
class Trial:
    """One thing changed about the scene.

    what     in words: "without Gravity", "StripAir quasi-steady", "no shear", "small
             displacements", "in the plane xy", "with Drag"
    change   of the quantity: RMS of the difference over the RMS of its motion; nan where the trial
             did not run
    time     of the trial over that of the scene as given, both in one run
    matters  whether the change exceeds the tolerance (a trial that did not run: True, it cannot be
             left out)
    note     why it did not run
    """

    what: str
    change: float
    time: float
    matters: bool
    note: str = ""


@dataclass(frozen=True)
class Advice:
    """Result of `advise`. `seconds`: CPU time of the unchanged scene. `together`: the trial with
    all negligible things changed at once, None if fewer than two are negligible. Printed, it is a
    table.

    Examples:
        >>> advice = tb.advise(
        ...     scene, [0.0, 0.02], tb.sensors.TipPosition(), step=0.01, repeats=1, show=False
        ... )
        >>> len(advice.trials) > 5  # print(advice): a table of them
        True
    """

    tolerance: float
    seconds: float
    trials: tuple[Trial, ...]
    together: Trial | None

    @property
    def matters(self) -> tuple[str, ...]:
        """Trials whose change exceeds the tolerance."""
        return tuple(t.what for t in self.trials if t.matters)

    def __str__(self) -> str:
        head = ("trial", "changes the answer by", "time", f"matters at {self.tolerance:g}")
        trials = self.trials if self.together is None else (*self.trials, self.together)
        rows = []
        for t in trials:
            numbers = (t.note, "") if t.note else (f"{t.change:.1e}", f"{t.time:.2f}")
            rows.append((t.what, *numbers, "yes" if t.matters else "no"))
        time = f"as given: {self.seconds:.3g} s of CPU time; times are shares of it"
        return "\n".join([*aligned([head, *rows]), time])


def advise(
    scene: Scene,
    t: Any,
    quantity: Callable[[State], Tensor],
    tolerance: float = 0.01,
    *,
    consider: Iterable[Effect] = (),
    initial: State | None = None,
    step: float | None = None,
    repeats: int = 2,
    show: bool = True,
    inputs: dict[str, Any] | None = None,
) -> Advice:
    """Run short trials of a scene, each with one change, and report which change matters for a
    quantity.

    Args:
        t: (time,) s, output times of a trial: long enough to show the quantity, short enough to run
            ten times
        quantity: a sensor, or a function: trajectory (`solution.state`, time first) -> tensor, time
            first
        tolerance: relative change of the quantity that matters
        consider: effects that the scene lacks, to be tried one by one
        initial, step, inputs: as in `simulate`;  repeats: number of timings of each trial; the
            least counts
        show: print the table

    Trials leave out each effect, the frame or root motion, extension and shear (by infinite
    stiffness), or rotary inertia. Others have less of an effect (air without lags or stall), small
    displacements (without geometric nonlinearity), or a plane (without motion out of it). All use
    the mesh and step of the scene, whose errors they do not show. Changes need not add up, so all
    negligible ones are tried once more together. The scene is not changed: the advice is data, see
    `Advice`.

    Raises ValueError for a tolerance that is not positive, RuntimeError where the scene itself does
    not run.

    Examples:
        >>> advice = tb.advise(
        ...     scene, [0.0, 0.02], tb.sensors.TipPosition(), step=0.01, repeats=1, show=False
        ... )
        >>> advice.tolerance  # print(advice): what matters
        0.01
    """
    instance("a scene", scene, Scene)
    check_function("quantity", quantity, "trajectory")
    check_tolerance("tolerance", tolerance)
    check_count("repeats", repeats)
    boolean("show", show)
    considered = tuple(
        instance("an effect to consider", effect, Effect) for effect in listed(consider)
    )

    def run(which: Scene) -> Solution:
        with torch.no_grad(), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            return simulate(which, t, initial=initial, step=step, inputs=inputs, throw=True)

    reference = quantity(run(scene).state)
    if not isinstance(reference, Tensor):
        raise refusal(f"a quantity that gave {shown(reference)}", "a tensor")
    changes = dict(_changes(scene, considered))
    first = {what: _try(scene, alter, run, quantity, reference) for what, alter in changes.items()}
    ran = {what: outcome for what, outcome in first.items() if isinstance(outcome, tuple)}
    runs = [lambda s=s: run(s) for s in (scene, *(s for s, _ in ran.values()))]
    base, *taken = seconds(runs, repeats)
    share = dict(zip(ran, taken, strict=True))
    trials = tuple(
        Trial(what, outcome[1], _over(share[what], base), not outcome[1] <= tolerance)
        if what in ran
        else Trial(what, math.nan, math.nan, True, outcome)
        for what, outcome in first.items()
    )
    together = _together(scene, changes, trials, run, quantity, reference, tolerance, repeats)
    advice = Advice(float(tolerance), base, trials, together)
    if show:
        print(advice)
    return advice


def _over(taken: float, base: float) -> float:
    """A time over another; NaN where that is below what the clock tells."""
    return taken / base if base else math.nan


def _try(
    scene: Scene, alter: Change, run: Any, quantity: Any, reference: Tensor
) -> tuple[Scene, float] | str:
    """(changed scene, how much it changes), or the sentence with which it was refused or failed."""
    try:
        changed = alter(scene)
        return changed, change(quantity(run(changed).state), reference)
    except (ValueError, RuntimeError) as refusal:
        return str(refusal).splitlines()[0]


def _together(
    scene: Scene,
    changes: dict[str, Change],
    trials: tuple[Trial, ...],
    run: Any,
    quantity: Any,
    reference: Tensor,
    tolerance: float,
    repeats: int,
) -> Trial | None:
    """Everything that does not matter, at once; of two planes the one that changes less; what was
    only considered stays out.
    """
    free = [t for t in trials if not t.matters and not t.what.startswith("with ")]
    planes = sorted((t for t in free if t.what.startswith("in the plane")), key=lambda t: t.change)
    free = [t for t in free if t not in planes[1:]]
    if len(free) < 2:
        return None

    def all_of(which: Scene) -> Scene:
        for trial in free:
            which = changes[trial.what](which)
        return which

    what, outcome = "all that does not matter", _try(scene, all_of, run, quantity, reference)
    if isinstance(outcome, str):
        return Trial(what, math.nan, math.nan, True, outcome)
    base, taken = seconds([lambda: run(scene), lambda: run(outcome[0])], repeats)
    return Trial(what, outcome[1], _over(taken, base), not outcome[1] <= tolerance)


def _changes(scene: Scene, consider: tuple[Effect, ...]) -> Iterator[tuple[str, Change]]:
    """Possible changes of this scene: (words, function from the scene to the changed one)."""
    for effect, name in zip(scene.effects, _names(scene.effects), strict=True):
        yield (
            f"without {name}",
            lambda s, gone=effect: replace(s, effects=tuple(e for e in s.effects if e is not gone)),
        )
        same = [effect]  # and what it becomes, as several of its changes go together
        for how in effect.simpler:
            yield f"{name} {how}", lambda s, same=same, how=how: _simplified(s, same, how)
    for name in ("frame", "root"):
        if getattr(scene, name) is not None:
            yield f"without the {name}'s motion", lambda s, name=name: replace(s, **{name: None})
    for name, rows in STRAINS.items():
        if not all(scene.beam.rigid[k] for k in rows):
            yield f"no {name}", lambda s, rows=rows: replace(s, beam=_rigid(s.beam, rows))
    if scene.beam.rotary:
        yield "no rotary inertia", lambda s: replace(s, beam=_without_rotary(s.beam))
    if not getattr(scene, "small", True):
        yield "small displacements", lambda s: replace(s, small=True)
    if getattr(scene, "plane", "") is None:
        for plane in ("xy", "xz"):
            yield f"in the plane {plane}", lambda s, plane=plane: replace(s, plane=plane)
    for effect, name in zip(consider, _names(consider), strict=True):
        yield f"with {name}", lambda s, more=effect: replace(s, effects=(*s.effects, more))


def _simplified(scene: Scene, same: list[Effect], how: str) -> Scene:
    """With less of an effect, which is one of `same` and comes to them; if it is still there."""
    for k, effect in enumerate(scene.effects):
        if any(effect is x for x in same) and how in effect.simpler:
            effects = *scene.effects[:k], effect.simpler[how], *scene.effects[k + 1 :]
            scene = replace(scene, effects=effects)
            same.append(scene.effects[k])
            return scene
    return scene


def _names(effects: tuple[Effect, ...]) -> list[str]:
    """Names of the effects' classes; numbered where one occurs again."""
    kinds = [e.called for e in effects]
    return [
        kind if kinds.count(kind) == 1 else f"{kind} {kinds[: k + 1].count(kind)}"
        for k, kind in enumerate(kinds)
    ]


def _rigid(beam: Beam, rows: tuple[int, ...]) -> Beam:
    """The beam with these strains made impossible."""
    like = beam.compliance
    keep = torch.tensor([float(k not in rows) for k in range(6)]).to(like)
    rigid = tuple(was or k in rows for k, was in enumerate(beam.rigid))
    return replace(beam, compliance=keep[:, None] * beam.compliance * keep, taper=None, rigid=rigid)


def _without_rotary(beam: Beam) -> Beam:
    """The beam with its mass on the axis alone."""
    if beam.offset:
        raise ValueError(
            "a section with an offset centre of mass has rotary inertia by that offset alone"
        )
    keep = (torch.arange(6, device=beam.mass.device) < 3).to(beam.mass)
    mass, more = (
        None if x is None else keep[:, None] * x * keep for x in (beam.mass, beam.mass_taper)
    )
    return replace(beam, mass=mass, mass_taper=more, rotary=False)


def seconds(runs: Sequence[Callable[[], Any]], repeats: int) -> list[float]:
    """CPU seconds of each run, the least of `repeats` in turns, so that load falls on all alike."""
    best = [float("inf")] * len(runs)
    for _ in range(repeats):
        for k, run in enumerate(runs):
            begun = time.process_time()
            run()
            best[k] = min(best[k], time.process_time() - begun)
    return best


def change(answer: Tensor, reference: Tensor) -> float:
    """RMS of the difference over the RMS of what the reference has moved from its first instant (or
    of itself, where it did not move); time is the first axis.
    """
    moved = (reference - reference[:1]).square().mean()
    size = torch.where(moved > 0, moved, reference.square().mean())
    return ((answer - reference).square().mean() / size).sqrt().item()
