"""converge: how many elements, which step? Sentences on what a search observed."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from torch import Tensor

from ...core.arguments import accuracy as check_accuracy
from ...core.arguments import function as check_function
from ...core.arguments import instance
from ...core.arguments import tolerance as check_tolerance
from ...core.docstrings import with_arguments_of
from ...core.validation import as_tensor, increasing, refusal
from ...scene.scene import Scene
from ...sensors.sensor import Sensor
from ...statics.equilibrium import equilibrium
from .convergence import Convergence, TriedSetting
from .law import LEAST_ORDER
from .reading import Reader, takes_scene
from .remesh import least_elements, remesh
from .search import Checked, Search
from .setting import ELEMENTS, METHODS, Limits, Setting
from .trials import TrialRuns

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


Report = Callable[[int, Setting], None]


@with_arguments_of(Limits)
def converge(
    scene: Scene | Callable[[int, int], Scene],
    t: Any,
    read: Sensor | Callable[..., Tensor],
    rtol: float = 1e-2,
    *,
    solve: Callable[[Scene], Any] | None = None,
    size: Any = None,
    share: float = 1.0,
    elements: Sequence[str] = ("linear", "linked", "order 2"),
    methods: Sequence[str] = ("midpoint", "midpoint4"),
    most_elements: int = 256,
    most_steps: int = 20_000,
    seconds: float = 60.0,
    initial: Any = None,
    inputs: dict[str, Any] | None = None,
    engine: str = "auto",
    progress: bool | Report = False,
) -> Convergence:
    """Find the cheapest element, mesh, method and step that give a quantity to `rtol`.

    Args:
        scene: on any mesh that `remesh` can replace; otherwise (structures) a function (elements,
            order) -> scene
        t: (time,) s of the motion; None = `solve(scene)` takes the place of `simulate`
        read: a sensor, or a function of the solution, or of the solution and its scene. It returns
            a history (time, ..., *) or numbers (..., *), with the batch's axes at `...`. An axis as
            long as t is time if it grows with t. A node means its arc length, also on other meshes
        rtol: relative error: RMS over instants and numbers, divided by the RMS change of the
            quantity from its first instant (for numbers, by their RMS)
        size: divisor in place of that RMS, in the quantity's units: a number, or (...)
        solve: function of the scene, without t: None = `tb.equilibrium`; `lambda scene:
            tb.modes(scene, count=3)`; anything that depends on the mesh alone
        initial, inputs, engine: as in `simulate`; initial may be a function of the scene
        progress: called with the number of runs so far and the next one's setting; True: a line
            each

    Each setting runs three times: as it is, with twice the elements, and with half the step. The
    two changes are its errors, which cannot cancel each other. Errors fall with observed orders;
    the next setting is the cheapest, by measured CPU time, that should suffice. Runs are shared:
    the mesh error may come from other steps, and the step error from another mesh, if that error is
    below 5 %. Equally cheap settings may alternate from call to call, because CPU times scatter.

    Returns:
        `Convergence`. If no setting reaches the error, it is the best one that was tried, with
        `converged` False and sentences that name the settings needed.

    Raises:
        ValueError: for a scene that `remesh` refuses, unknown names, or a reading whose shape
            depends on the mesh.
        RuntimeError: where no setting's run succeeds.

    Examples:
        >>> best = tb.converge(
        ...     scene, None, lambda state: state.tip.position, rtol=0.05, solve=tb.equilibrium
        ... )
        >>> best.error < 0.05  # print(best): every run, the choice
        True
    """
    begun = time.process_time()
    check_accuracy("rtol", rtol)
    limits = Limits(share, elements, methods, most_elements, most_steps, seconds).checked()
    make, base, first, t = _problem(scene, t, read, size, solve)
    if t is None and (initial is not None or inputs is not None):
        raise ValueError(
            "initial or inputs were given without t; a function `solve` that takes them is wanted"
        )
    options = {} if t is None else dict(initial=initial, inputs=inputs, engine=engine)
    reader, report = Reader(read, first, size), _report(progress)
    run = solve or equilibrium
    trials = TrialRuns(make, reader, t, run, limits.share, options, report, limits.seconds)
    interval = None if t is None else t.diff().min().item()
    searched = limits.elements, [] if t is None else limits.methods
    search = Search(trials, float(rtol), base, interval, *searched, (most_elements, most_steps))
    best = _succeeded(search.run(), trials)
    found, said = trials(best.setting).result, tuple(notes(search, best))
    how = best.setting, trials.scene(best.setting), float(rtol), best.space, best.time
    return Convergence(found, *how, said, _table(trials, best), time.process_time() - begun)


def _succeeded(best: Checked, trials: TrialRuns) -> Checked:
    """The best that was checked. Raises RuntimeError where no run succeeded."""
    if math.isinf(best.error) and bool(trials(best.setting).failed.all()):
        raise RuntimeError(
            f"no run of the scene succeeded, the finest by {best.setting}; a scene that "
            "`simulate` solves is wanted"
        )
    return best


def _problem(
    scene: Any, t: Any, read: Any, size: Any, solve: Any
) -> tuple[Callable[[Setting], Scene], int, Scene, Tensor | None]:
    """How to make a scene by a setting, the divisor of its elements, one such scene, instants."""
    if not isinstance(read, Sensor):
        check_function("read", read, *("solution", "scene")[: 1 + takes_scene(read)])
    if solve is not None:
        check_function("solve", solve, "scene")
        if t is not None:
            raise refusal("t and solve", "one of them", were=True)
    if isinstance(scene, Scene):
        first, base = scene, least_elements(scene, Reader(read, scene).nodes())

        def make(setting: Setting) -> Scene:
            return remesh(scene, **setting.mesh)

    else:
        check_function("scene", scene, "elements", "order")
        first, base = instance("what scene(4, 1) gives", scene(4, 1), Scene), 1

        def make(setting: Setting) -> Scene:
            made = scene(setting.elements, setting.mesh["order"])
            if not setting.mesh["linked"]:
                return made
            if made.beam.parts:
                raise ValueError("linked interpolation of a structure's beams is theirs to say")
            return replace(made, beam=made.beam.linked())

    if size is not None:
        check_tolerance("size", size, each=True)
    if t is not None:
        t = increasing("t", as_tensor(t, first.dtype, first.device)).detach()
    return make, base, first, t


def _report(progress: bool | Report) -> Report | None:
    if progress is True:
        return lambda done, setting: print(f"run {done + 1}: {setting}", file=sys.stderr)
    return None if progress is False else check_function("progress", progress, "done", "setting")


def _table(trials: TrialRuns, best: Checked) -> tuple[TriedSetting, ...]:
    """All that was run, against the chosen reading with what its finer levels change."""
    chosen = trials(best.setting).reading
    limit = chosen.clone()
    for coarse, fine in best.levels:
        limit = limit + (trials(fine).reading - trials(coarse).reading)
    limit = replace(trials(best.setting), reading=limit)
    tried = []
    for trial in trials.made.values():
        steps = None if trials.t is None else trials.step_count(trial.setting.step)
        off, chosen = trials.apart(trial, limit), trial.setting == best.setting
        tried.append(
            TriedSetting(trial.setting, steps, off, trial.seconds, trial.iterations, chosen)
        )
    return tuple(tried)
