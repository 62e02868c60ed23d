"""Relations of runs: batches and singles, restarts, outputs, ways to give times and inputs, steps
one by one, both modes.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import torch
import torch.autograd.forward_ad as forward_ad
from torch import Tensor

import torchbeam as tb
from tests.cases.gradient_cases import Case, exact
from tests.cases.metamorphic_answers import ANSWERS, Found, energies, states, told
from tests.cases.metamorphic_said import SAMPLES, Blocks, Pair, Said, engine, wants

# by `simulate` in steps
MOTIONS = ("midpoint", "midpoint lumped", "midpoint conserve", "midpoint4", "generalized_alpha")
BY_STEPS = {
    "midpoint": "stepper midpoint",
    "midpoint4": "stepper midpoint4",
    "generalized_alpha": "stepper generalized_alpha",
}


def batch(said: Said) -> Pair:
    """Several at once, and one by one."""
    wants(said, ANSWERS[said.answer].batched and not said.case.draw.alone - {"times", "t"})
    together, alone = said.several()
    whole, each = said.of(together), [said.of(x) for x in alone]
    if said.answer == "path":  # each sample goes at its own pace
        whole = {n: v[-1] for n, v in whole.items()}
        each = [{n: v[-1] for n, v in x.items()} for x in each]
    return whole, _stacked(each, whole)


def _stacked(few: list[Blocks], like: Blocks) -> Blocks:
    """Samples one by one with the axis of the samples where the batch has it."""
    found = {}
    for name, value in like.items():
        one = few[0][name]
        axis = _batch_axis(value, one)
        found[name] = value if axis is None else torch.stack([x[name] for x in few], axis)
        if axis is None:  # nothing in it differs from sample to sample
            found[name] = one.expand_as(value)
    return found


def _batch_axis(value: Tensor, one: Tensor) -> int | None:
    """Where a value of several has the axis that one has not; None = nowhere."""
    return next(
        (
            i
            for i in range(value.ndim)
            if value.shape[i] == SAMPLES and value.shape[:i] + value.shape[i + 1 :] == one.shape
        ),
        None,
    )


def axes(said: Said) -> Pair:
    """Batch axes (2, 1) and (1, 2) of different tensors, and both on all."""
    wants(said, ANSWERS[said.answer].batched and said.answer != "path")
    wide, full = {}, {}
    for k, (n, v) in enumerate(said.x.items()):
        if n in said.case.draw.alone:
            wide[n] = full[n] = v
            continue
        scale = 1 + 0.01 * torch.arange(2.0)
        scale = scale[:, None] if k % 2 else scale[None, :]
        wide[n] = v * scale[(...,) + (None,) * v.ndim]
        full[n] = v * scale.expand(2, 2)[(...,) + (None,) * v.ndim]
    return said.of(wide), said.of(full)


def chunks(said: Said) -> Pair:
    """Several at once, and by `monte_carlo` in chunks, of which the last is smaller."""
    wants(said, ANSWERS[said.answer].batched and not said.case.draw.alone - {"times", "t"})
    wants(said, said.answer != "path")  # its samples go at their own pace
    whole = said.of(said.several()[0])
    axes = {n: _batch_axis(value, said.plain[n]) for n, value in whole.items()}

    def rows(found: Blocks) -> Tensor:
        several = (found[n].movedim(axis, 0) for n, axis in axes.items() if axis is not None)
        return torch.cat([value.reshape(len(value), -1) for value in several], 1)

    def of(theta: Tensor) -> Tensor:
        return rows(said.of(said.scaled(theta[:, 0])))

    scale = 1 + 0.01 * torch.arange(SAMPLES)
    wants(said, any(axis is not None for axis in axes.values()))
    samples = tb.monte_carlo(of, ["scale"], theta=scale[:, None], chunk=SAMPLES - 1)
    sizes = rows(whole).abs().amax(0).clamp(min=1e-3)
    return {"samples": rows(whole) / sizes}, {"samples": samples.y / sizes}


def single(said: Said) -> Pair:
    """A scene in single precision, and in double."""
    return _narrow(said, torch.float32)


def in_default(said: Said) -> Pair:
    """Tensors of single precision under PyTorch's own default, and the same numbers in double."""
    return _narrow(said, None)


def _narrow(said: Said, dtype: torch.dtype | None) -> Pair:
    x = {n: v.float() for n, v in said.x.items()}
    default = torch.get_default_dtype()
    try:
        torch.set_default_dtype(torch.float32)
        b = replace(said, x=x, case=Case(said.spec, dtype=dtype)).plain
    except ValueError as error:  # of a function with matrices of its own
        wants(said, "a function that does not take" not in str(error))
        raise
    finally:
        torch.set_default_dtype(default)
    floating = {v.dtype for v in b.values() if v.is_floating_point()}
    assert floating == {dtype or torch.float64}, floating
    return said.of({n: v.double() for n, v in x.items()}), {n: v.double() for n, v in b.items()}


def vmapped(said: Said) -> Pair:
    wants(said, said.answer in (*BY_STEPS, "equilibrium", "modes"))
    together, _ = said.several()
    dims = {n: None if n in said.case.draw.alone else 0 for n in together}
    with engine("eager"):
        found = torch.func.vmap(said.of, (dims,))(together)
        plain = said.of(together)
    return {n: v.movedim(0, -1) for n, v in found.items()}, {
        n: plain[n].movedim(_axis(plain[n], found[n]), -1) for n in plain
    }


def _axis(value: Tensor, like: Tensor) -> int:
    return next(i for i in range(value.ndim) if value.movedim(i, 0).shape == like.shape)


def engines(said: Said) -> Pair:
    with engine("eager"):
        a = said.of(said.x)
    with engine("compiled"):
        return a, said.of(said.x)


def restart(said: Said, through: Callable = lambda state: state) -> Pair:
    wants(said, said.answer in MOTIONS or said.answer == "nodal rk4")
    p, method = said.problem, said.answer.split()[0]
    if said.answer == "nodal rk4":
        options = dict(method="rk4", inputs=p.inputs)
    else:
        options = dict(
            method=method, inputs=p.inputs, step=p.step,
            **dict.fromkeys(said.answer.split()[1:], True), **exact(),
        )  # fmt: skip
    whole = tb.simulate(p.scene, p.t, p.start, **options)
    first = tb.simulate(p.scene, p.t[:2], p.start, **options)
    last = tb.simulate(p.scene, p.t[1:], through(first.state[-1]), **options)
    a, b = told(states("motion", whole.state[2:])), told(states("motion", last.state[1:]))
    return a | {"motion work": a["motion work"] - whole.state[1].work}, b


def _saved(state: tb.State) -> tb.State:
    return _through_file(state.detach())


def _through_file(thing: Any) -> Any:
    file = io.BytesIO()
    torch.save(thing, file)
    file.seek(0)
    return torch.load(file, weights_only=False)


def from_a_file(said: Said) -> Pair:
    """What a scene is made of, its inputs and its start, but for functions that no file holds."""
    p = said.problem
    try:
        stored = _through_file((p.parts, p.inputs, p.start))
    except (pickle.PicklingError, AttributeError, TypeError):
        stored = None
    wants(said, stored is not None)
    parts, inputs, start = stored
    return said.plain, told(said.ask(replace(p, parts=parts, inputs=inputs, start=start)))


def _solved(said: Said, t=None, **changed) -> Found:
    p, answer = said.problem, said.answer
    method, *more = answer.split()
    options = (
        dict(
            initial=p.start,
            method=method,
            inputs=p.inputs,
            step=p.step,
            **dict.fromkeys(more, True),
            **exact(),
        )
        | changed
    )
    solution = tb.simulate(p.scene, p.t if t is None else t, **options)
    return states("motion", solution.state[1:]) | energies(solution)


def _way(said: Said, make: Callable[[Said], dict]) -> Pair:
    wants(said, said.answer in MOTIONS)
    return said.plain, told(_solved(said, **make(said)))


def by_list(said: Said) -> dict:
    return dict(t=said.problem.t.tolist())


def with_checkpoint(said: Said) -> dict:
    return dict(checkpoint=True)


def by_keyword(said: Said) -> dict:
    wants(
        said, bool(said.problem.inputs) and all(name.isidentifier() for name in said.problem.inputs)
    )
    return dict(inputs=None, **said.problem.inputs)


def by_functions(said: Said) -> dict:
    inputs = said.problem.inputs
    wants(said, bool(inputs) and not any(map(callable, inputs.values())))
    return dict(inputs={n: lambda t, v=v: v for n, v in inputs.items()})


def by_intervals(said: Said) -> dict:
    inputs, K = said.problem.inputs, len(said.problem.t) - 1
    wants(said, bool(inputs) and not any(map(callable, inputs.values())))
    return dict(
        inputs={
            n: tb.PerInterval(v[..., None, :].expand(*v.shape[:-1], K, v.shape[-1]))
            for n, v in inputs.items()
        }
    )


def finer(said: Said) -> Pair:
    """Outputs in the middle of equal steps, and without."""
    wants(said, said.answer in MOTIONS)
    t, p = said.problem.t, said.problem
    wants(said, not any(isinstance(v, tb.PerInterval) for v in p.inputs.values()))
    fine = torch.stack((t[0], (t[0] + t[1]) / 2, t[1]))
    step = float((t[1] - t[0]) / 2)
    a, b = _solved(said, t=t[:2], step=step), _solved(said, t=fine, step=step)
    return told(a), {
        n: v[-1:] if n.startswith("motion") else v
        for n, v in told({n: (q, v) for n, (q, v) in b.items()}).items()
        if n.startswith("motion")
    } | {n: v[[0, -1]] for n, v in told(b).items() if not n.startswith("motion")}


def threads(said: Said) -> Pair:
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        b = said.of(said.x)
    finally:
        torch.set_num_threads(before)
    return said.plain, b


def by_steps(said: Said) -> Pair:
    """`simulate` and `Stepper`, inputs held."""
    wants(said, said.answer in BY_STEPS and not any(map(callable, said.problem.inputs.values())))
    b = told(said.ask(answer=BY_STEPS[said.answer]))
    last = {name.removeprefix("last "): v for name, v in b.items() if name.startswith("last")}
    return {n: said.plain[f"motion {n}"][-1] for n in last}, last


def by_rollout(said: Said) -> Pair:
    """`rollout`, and `Stepper` step by step; its step is a number."""
    wants(said, said.answer == "rollout" and not any(map(callable, said.problem.inputs.values())))
    p = said.problem
    step, found = tb.Stepper(p.scene, p.step, **exact()), []
    state = tb.rest(p.scene, t=p.t[0]) if p.start is None else p.start
    for _ in range(3):
        found.append(step(state := found[-1] if found else state, inputs=p.inputs))
    each = [told(states("rollout", s)) for s in found]
    return said.plain, {
        n: torch.stack([e[n].expand(said.plain[n].shape[1:]) for e in each]) for n in said.plain
    }


def dual(said: Said) -> Pair:
    """<v, J u> = <J^T v, u>"""
    wants(said, ANSWERS[said.answer].gradient and any(v.requires_grad for v in said.x.values()))
    draw = torch.Generator().manual_seed(said.spec.seed)
    u = {
        n: 0.1 * said.case.draw.size[n] * torch.randn(v.shape, generator=draw)
        for n, v in said.x.items()
    }
    v = None

    def of(x: Blocks) -> Tensor:
        nonlocal v
        blocks = said.of(x)
        if v is None:
            v = {
                n: torch.randn(b.shape, generator=draw) / b.detach().abs().max().clamp(min=1e-3)
                if b.numel()
                else b.detach()
                for n, b in blocks.items()
            }
        return sum((v[n] * b).sum() for n, b in blocks.items())

    y = of(said.x)
    slopes = torch.autograd.grad(y, list(said.x.values()), allow_unused=True)
    back = sum(
        (g * u[n]).sum() for (n, _), g in zip(said.x.items(), slopes, strict=True) if g is not None
    )
    forward = _jvp(of, said.x, u)
    size = sum(
        (g * u[n]).abs().sum()
        for (n, _), g in zip(said.x.items(), slopes, strict=True)
        if g is not None
    )
    return {"product": (back / size).detach()[None]}, {"product": (forward / size)[None]}


def _jvp(of: Callable, x: Blocks, u: Blocks) -> Tensor:
    with forward_ad.dual_level():
        y = forward_ad.unpack_dual(
            of({n: forward_ad.make_dual(v.detach(), u[n]) for n, v in x.items()})
        )
        return torch.zeros_like(y.primal) if y.tangent is None else y.tangent


# fmt: off
RUNS: dict[str, Callable[[Said], Pair]] = {
    "batch": batch, "axes": axes, "chunks": chunks, "vmap": vmapped, "engines": engines,
    "threads": threads, "dual": dual, "single precision": single,
    "default dtype": in_default,
    "scene from a file": from_a_file,
    "restart": restart, "restart from a file": partial(restart, through=_saved),
    "restart from a clone": partial(restart, through=lambda state: state.clone()),
    "t as a list": partial(_way, make=by_list), "checkpoint": partial(_way, make=with_checkpoint),
    "inputs by keyword": partial(_way, make=by_keyword),
    "inputs as functions": partial(_way, make=by_functions),
    "inputs per interval": partial(_way, make=by_intervals),
    "finer outputs": finer, "by steps": by_steps, "by rollout": by_rollout,
}
# fmt: on
