"""Design: which sensors, where, and which inputs tell most of the parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import boolean, choice, count, listed, number
from ...core.arguments import tolerance as check_tolerance
from ...core.validation import as_tensor, common_dtype, refusal, shown
from .design_result import Design
from .experiment import Model
from .information import DERIVATIVES, UNKNOWN, Information, drawn
from .measurement import Measurement, each
from .parameters import Parameters
from .selection import CRITERIA, Criterion, Selection, choose_both

METHODS = ("exchange", "greedy")


def design(
    model: Model,
    candidates: Mapping[str, Any] | Sequence[Measurement],
    start: Any,
    *,
    sensors: int | None = None,
    budget: float | None = None,
    cost: Mapping[str, float] | float = 1.0,
    most: int = 1,
    present: Sequence[str] = (),
    inputs: Any = None,
    runs: int = 1,
    criterion: str = "D",
    of: Any = None,
    correlation: Mapping[str, float] | float | None = None,
    method: str = "exchange",
    draws: int = 1,
    seed: int = 0,
    log: bool = False,
    derivatives: str = "auto",
    relative_step: float | None = None,
) -> Design:
    """Choose the sensors and inputs that tell most about the parameters, before any measurement.
    The criterion uses the information J^T R^-1 J of their readings, with the curvature of the
    priors. J has the derivatives at the start, from a batch of 2 p + 1 simulations for each input
    and draw. R is the covariance of the noise.

    Args:
        model: as in `identify`; with inputs model(theta, u), u (N, ...) the input of each sample of
            theta. A model of tensors returns a tuple with a tensor for each measurement
        candidates: name -> `Measurement` with sigma and without values (None; NaN of their shape
            where it has no sensor), or a list of measurements that come together. Offsets, drifts
            and hum are further parameters, which reduce the information
        start: as in `identify`: the point of the derivatives
        sensors: number of sensors; None = as many as the budget pays, or all
        budget: largest total cost; `cost` is that of each sensor, or by name
        most: how often a candidate may be chosen
        present: names of candidates that are always present, at no cost
        inputs: (K, ...), or name -> (...): inputs to choose `runs` from, which may repeat; all
            sensors read each run, and each run has offsets of its own
        criterion: quantity to minimise. "D": the geometric mean of the axes of the ellipsoid of
            deviations. "A": the RMS of deviations over the parameters' sizes. "c": the RMS
            deviation of `of`
        of: names of the parameters that matter; None = all. Or a function of theta, as in the
            model, that returns the quantities to know (N, ...)
        correlation: correlation of noise="ar1" between consecutive readings, common or by name:
            `Fit.memory`
        method: "greedy": add sensors in turn; "exchange": then swap sensors as long as that helps
        draws: number of draws of the parameters from their priors. Criteria are means over draws
            ("D" of logarithms, else of variances), so the design does not depend on a single guess
        log, derivatives, relative_step: as of `identify`

    Places are not optimised by gradients: list candidates on a grid, which all read the same
    simulations. A grid of spacing h loses h^2 of the criterion. (Fedorov 1972, Theory of Optimal
    Experiments; Atkinson, Donev and Tobias 2007, Optimum Experimental Designs, with SAS.)

    Raises:
        ValueError: for candidates that together do not determine `of`, lack sigma, or have noise
            known only from data (repeats, blocks, losses). For a budget below any cost, and a model
            that fails at the start.

    Examples:
        >>> x = torch.linspace(0, 1, 11)
        >>> line = lambda p: (p["a"][:, None] + p["b"][:, None] * x).unbind(-1)
        >>> places = {f"{s:.1f}": tb.Measurement(torch.nan, 0.1) for s in x.tolist()}
        >>> plan = tb.design(line, places, {"a": 1.0, "b": 2.0}, sensors=4, most=2)
        >>> sorted(plan.sensors)  # the ends
        ['0.0', '0.0', '1.0', '1.0']
    """
    return _designed(locals())


def _designed(o: Mapping[str, Any]) -> Design:
    """See `design`, whose arguments these are."""
    choice("method", o["method"], METHODS)
    choice("criterion", o["criterion"], CRITERIA)
    choice("derivatives", o["derivatives"], DERIVATIVES)
    if o["relative_step"] is not None:
        check_tolerance("relative_step", o["relative_step"])
    groups = _candidates(o["candidates"])
    every, labels, u = [*groups], *_inputs(o["inputs"])
    like = [m.values for group in groups.values() for m in group]
    parameters = Parameters.of(o["start"], boolean("log", o["log"]), None, None, [], like)
    parameters = drawn(parameters, count("draws", o["draws"]), o["seed"])
    # fmt: off
    known = Information.of(o["model"], [*groups.values()], parameters, u, o["correlation"],
                           o["derivatives"], o["relative_step"])
    # fmt: on
    price = _prices(o["cost"], every).to(parameters.start)
    there = [every.index(choice("present", name, every)) for name in listed(o["present"])]
    times = torch.full_like(price, count("most", o["most"]), dtype=torch.long)
    times[there] = 0
    limit = math.inf if o["budget"] is None else number("budget", o["budget"])
    if not (price[times > 0] <= limit).any():
        raise ValueError(
            f"budget = {shown(o['budget'])} was given for {int((times > 0).sum())} candidates to "
            "choose from, none of which it pays; more is wanted"
        )
    wanted = math.inf if o["sensors"] is None else count("sensors", o["sensors"])
    wanted, runs = min(wanted, int(times.sum())), count("runs", o["runs"])
    with torch.no_grad():
        rule, base, items, unit = _information(known, o["criterion"], o["of"], runs)

        def of_sensors(weight: Tensor) -> Selection:
            by = torch.einsum("k,jk...->j...", weight, items)
            return Selection(rule, base + by[there].sum(0), by, price, times, wanted, limit)

        def of_runs(chosen: Sequence[int]) -> Selection:
            by = items[[*there, *chosen]].sum(0)
            often = times.new_full((len(by),), runs)
            return Selection(rule, base, by, price.new_ones(len(by)), often, runs)

        chosen, weight = choose_both(of_sensors, of_runs, o["method"] == "exchange")
        run_counts = dict(zip(labels, weight.round().int().tolist(), strict=True))
        return Design.of(known, of_sensors(weight), chosen, there, groups, run_counts, unit)


def _information(
    known: Information, criterion: str, of: Any, runs: int
) -> tuple[Criterion, Tensor, Tensor, Tensor]:
    """Criterion, information before and of each candidate and input, of coordinates over `unit`
    (p,), by which all of them together know each as well.
    """
    base, items = known.before(), known.each()
    if callable(of):
        names, G = known.of_function(of)
    else:
        names, G = known.of_parameters(None if of is None else listed(of), criterion)
    unit = (base + items.sum((0, 1))).mean(0).diagonal().sqrt()
    unit = torch.where(unit > 0, unit, 1)
    base, items = (part / unit / unit[:, None] for part in (base, items))
    rule = Criterion(criterion, G / unit)
    if (blind := rule.open(base + runs * items.sum((0, 1)))).any():
        raise ValueError(
            f"candidates that do not tell {names[int(blind.int().argmax())]} even together were "
            "given; others, or a prior, are wanted"
        )
    return rule, base, items, unit


def _candidates(candidates: Any) -> dict[str, list[Measurement]]:
    """Measurements of each, by name."""
    if isinstance(candidates, (list, tuple)):
        labels = [getattr(m, "name", None) or getattr(m.sensor, "name", f"candidate {k}")
                  if isinstance(m, Measurement) else f"candidate {k}"
                  for k, m in enumerate(candidates)]  # fmt: skip
        if len(set(labels)) < len(labels):
            raise refusal("candidates of one name", "a name for each", were=True)
        candidates = dict(zip(labels, candidates, strict=True))
    if not isinstance(candidates, Mapping) or not candidates:
        raise refusal(f"candidates = {shown(candidates)}", "name -> tb.Measurement", were=True)
    groups = {}
    for name, measurements in candidates.items():
        group = each(measurements)
        for m in group:
            if not isinstance(m, Measurement) or m.sigma is None:
                what = "without sigma" if isinstance(m, Measurement) else f"= {shown(m)}"
                raise refusal(f"the candidate {name!r} {what}", "a tb.Measurement with sigma")
            if m.loss or m.noise in UNKNOWN:
                kind = f"loss={m.loss!r}" if m.loss else f"noise={m.noise!r}"
                raise refusal(f"the candidate {name!r} with {kind}, which only data tell,",
                              "noise='white' or 'ar1'")  # fmt: skip
        groups[str(name)] = [replace(m, name=m.name or str(name)) for m in group]
    return groups


def _inputs(inputs: Any) -> tuple[list[str], Tensor | None]:
    """Names (K,) and values (K, ...)."""
    if inputs is None:
        return ["run"], None
    names = [*map(str, inputs)] if isinstance(inputs, Mapping) else None
    if names:  # each a row, whatever axes it has
        kind = common_dtype(*inputs.values())
        inputs = torch.stack([as_tensor(u, *kind) for u in inputs.values()])
    values = as_tensor(inputs, *common_dtype(inputs))
    if not values.ndim or not len(values):
        raise refusal(f"inputs of shape {tuple(values.shape)}", "(K, ...)", were=True, are=True)
    return names or [*map(str, range(len(values)))], values


def _prices(cost: Any, names: Sequence[str]) -> Tensor:
    """(candidates,) of a number, or numbers by name."""
    if isinstance(cost, Mapping):
        if wrong := set(names) ^ set(cost):
            raise ValueError(
                f"a cost of {', '.join(map(str, cost))} was given for candidates "
                f"{', '.join(names)}; one of each is wanted, {sorted(map(str, wrong))[0]} is not"
            )
        values = [number(f"the cost of {name!r}", cost[name]) for name in names]
    else:
        values = [number("cost", cost)] * len(names)
    if not min(values) > 0:
        raise refusal(f"a cost of {min(values):g}", "a positive one")
    return torch.tensor(values, dtype=torch.float64)
