"""Check that what users wrote gives each sample of a batch what its own motion asks, whatever the
others are: tried once for each function, at its first call with several samples.

Native code evaluates such functions sample by sample, and eager calls have the samples that they
need: a mean over the batch, a roll, a sort, or the number of samples is another in each of them.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any
from weakref import ref

import torch
from torch import Tensor
from torch._C import _functorch as functorch
from torch.utils._python_dispatch import _get_current_dispatch_mode

from ..core.leaves import own_leaves, with_values
from ..math.quaternions import skew
from ..math.shapes import broadcast_shapes
from ..scene.effects import Inputs, Load, LoadEffect, LoadPoint
from ..scene.effects.effect import is_own, of_library, parts_of
from ..scene.effects.load_point import together

# fields of a point and their axes, those of sites along the beam apart
MOTION = ("position", "velocity", "spin", "acceleration", "angular_acceleration", "internal")
AT_SITES = {"R": 2, "mass": 2, "s": 0} | dict.fromkeys(MOTION, 1)
OF_ALL = {"axes": 2, "dt": 0, "told": 2}
OF_INTERACTION = {"own": 1, "internal": 1}
FEW = 3  # samples of an axis that are enough, but for functions that hold rows for all of them
TURN = 0.3  # rad
SHARE = 0.1  # of the numbers that a load takes by name

_CHECKED: dict[int, Any] = {}  # functions and classes by id; no result depends on it


def written(load: Any) -> tuple[Any, ...]:
    """Functions of the motion that a user wrote and a load holds; its class, and those of what it
    holds, if a user wrote them.
    """
    functions = [
        leaf.value for leaf in own_leaves(load) if leaf.axes is None and callable(leaf.value)
    ]
    return (*functions, *(type(part) for part in parts_of(load) if not is_own(part)))


def are_checked(functions: tuple[Any, ...]) -> bool:
    """Whether all of these have been."""
    for function in functions:
        held = _CHECKED.get(id(function))
        if held is None or (held() if isinstance(held, ref) else held) is not function:
            return False
    return True


def check_samples(
    acting: Any, point: LoadPoint, t: Tensor, inputs: Inputs, batch: tuple[int, ...] = ()
) -> None:
    """Try the functions that a user wrote and a load holds that acts, where they have not been, and
    where there are several samples; `batch`: of axes that nothing that is given has.

    Raises:
        ValueError: for one that mixes the samples of a batch.
    """
    load = acting.load
    if not acting.functions or are_checked(acting.functions):
        return
    if functorch.peek_interpreter_stack() is not None or _get_current_dispatch_mode() is not None:
        return
    trial = SampleTrial.of(load, point, t, inputs, batch)
    if trial.batch.numel() < 2:
        return
    mixed = False
    # what a function reads beside its arguments may want all samples, or no other motion
    for few, size in ((FEW, 1.0), (None, 1.0), (None, 0.0)):
        # errors of the user's function are raised where it is asked, too
        with suppress(Exception), torch.no_grad(), torch.random.fork_rng(devices=[]):
            drawn = (trial if few is None else trial.of_few(few)).drawn(size)
            mixed = drawn.mixes()
            break
    if mixed:
        raise ValueError(
            f"{_called(load)} was given, which mixes the samples of a batch: what it gives one of "
            "them changes with the others, or with their number; a function of each sample's own "
            "motion is wanted (no mean, sort, roll, shape of the leading axes)"
        )
    for function in written(load):
        _mark(function)


def _mark(one: Any) -> None:
    key = id(one)
    try:
        _CHECKED[key] = ref(one, lambda _: _CHECKED.pop(key, None))
    except TypeError:  # it has no weak references
        _CHECKED[key] = one


def _called(load: Any) -> str:
    if not of_library(load):
        return f"an effect of the class {type(load).__name__}"
    names = [getattr(function, "__name__", type(function).__name__) for function in written(load)]
    return f"{load.called} with the function {' and '.join(map(repr, names))}"


Values = dict[tuple[str, str], tuple[Tensor, int]]  # by whose they are, and name; with own axes


@dataclass
class SampleTrial:
    """A load in some motions: tensors with their axes behind those of the batch (...)."""

    load: LoadEffect
    point: LoadPoint
    values: Values
    batch: torch.Size

    @classmethod
    def of(
        cls, load: Any, point: LoadPoint, t: Tensor, inputs: Inputs, batch: tuple[int, ...]
    ) -> SampleTrial:
        along = load.node is None
        axes = {name: count + along for name, count in AT_SITES.items()} | OF_ALL
        axes |= OF_INTERACTION if load.kind == "interaction" else {}
        values = {("point", name): (getattr(point, name), count) for name, count in axes.items()}
        values |= {("input", name): (x, 1) for name, x in inputs.items()}
        values |= {("time", ""): (t, 0)} | _of_load(load)
        values = {key: (x, axes) for key, (x, axes) in values.items() if isinstance(x, Tensor)}
        shapes = (x.shape[: x.ndim - axes] for x, axes in values.values())
        return cls(load, point, values, broadcast_shapes(batch, *shapes))

    def of_few(self, count: int) -> SampleTrial:
        """The first of the samples along each axis, and the last."""
        trial = self
        for axis, size in enumerate(self.batch):
            if size > count:
                trial = trial.of_samples(axis, [*range(count - 1), size - 1])
        return trial

    def of_samples(self, axis: int, samples: list[int]) -> SampleTrial:
        """These along one of the batch's axes."""
        back = len(self.batch) - axis

        def taken(x: Tensor, axes_count: int) -> Tensor:
            at = x.ndim - axes_count - back
            if at < 0 or x.shape[at] == 1:
                return x
            return x.index_select(at, torch.tensor(samples, device=x.device))

        values = {key: (taken(x, axes), axes) for key, (x, axes) in self.values.items()}
        batch = (*self.batch[:axis], len(samples), *self.batch[axis + 1 :])
        return SampleTrial(self.load, self.point, values, torch.Size(batch))

    def drawn(self, size: float) -> SampleTrial:
        """Each sample in a motion of its own: moved by up to `size` of what is there."""
        generator = torch.Generator().manual_seed(0)

        def moved(whose: str, name: str, x: Tensor, axes_count: int) -> Tensor:
            shape = (*self.batch, *x.shape[x.ndim - axes_count :])
            shape = (*shape[:-1], 3) if name == "R" else shape
            shift = size * torch.rand(shape, dtype=x.dtype, generator=generator).to(x.device)
            if name == "R" and whose == "point":
                return x @ torch.linalg.matrix_exp(skew(TURN * shift[..., 0, :]))
            if whose == "load":
                return x * (1 + SHARE * shift)
            most = x.nan_to_num().abs().amax() if x.numel() else x.new_zeros(())
            return x + torch.where(most > 0, most, 1.0) * shift

        values = {
            key: (moved(*key, x, axes), axes)
            if key[0] in ("input", "load") or key[1] in (*MOTION, "R")
            else (x, axes)
            for key, (x, axes) in self.values.items()
        }
        return SampleTrial(self.load, self.point, values, self.batch)

    def outputs(self) -> list[Tensor]:
        """What the load gives, (..., own axes)."""
        named: dict[str, dict[str, Tensor]] = {}
        for (whose, name), (x, _) in self.values.items():
            named.setdefault(whose, {})[name] = x
        point, (t,) = replace(self.point, **named["point"]), named["time"].values()
        inputs, of_load, load = named.get("input", {}), named.get("load", {}), self.load
        if of_load:
            load = with_values(load, **({"values": of_load} if isinstance(load, Load) else of_load))
        outputs = [together(load.wrench(point, t, inputs), point.R)]
        if load.internal and isinstance(load, Load):
            outputs.append(load.rates(point, point.internal, t, inputs))
        if load.kind == "interaction":
            more = [load.residual] * bool(load.unknowns) + [load.remember] * bool(load.memory)
            outputs += [method(point, t, inputs)[..., None] for method in more]
        return outputs

    def mixes(self) -> bool:
        """Whether a sample is given something else among others than among copies of itself, or
        alone; not where no call is as the one before.
        """
        whole, axes = self.outputs(), 1 + (self.load.node is None)
        for axis, size in enumerate(self.batch):
            for k in {0, size - 1} if size > 1 else ():
                others = [self.of_samples(axis, [k] * size).outputs()]
                with suppress(Exception):  # it holds what has a row for each
                    others.append(self.of_samples(axis, [k]).outputs())
                back = axes + len(self.batch) - axis
                if any(
                    not _close(_row(x, back, k), _row(y, back, k), x)
                    for outputs in others
                    for x, y in zip(whole, outputs, strict=True)
                ):
                    again = self.outputs()
                    return all(_close(x, y, x) for x, y in zip(whole, again, strict=True))
        return False


def _of_load(load: Any) -> Values:
    """A load's own tensors that can be told apart by samples."""
    if isinstance(load, Load):
        axes = int(load.node is None)
        return {("load", name): (x, axes) for name, x in (load.values or {}).items()}
    if type(load).at_sites is not LoadEffect.at_sites:
        return {}
    return {("load", x.name): (x.value, x.axes) for x in own_leaves(load) if x.axes is not None}


def _row(x: Tensor, back: int, k: int) -> Tensor:
    """Sample k of an axis, counted from the end; of one that has it alone, or not at all, that."""
    at = x.ndim - back
    return x if at < 0 or x.shape[at] == 1 else x.narrow(at, k, 1)


def _close(a: Tensor, b: Tensor, like: Tensor) -> bool:
    share = torch.finfo(like.dtype).eps ** 0.5
    least = share * float(like.nan_to_num(posinf=0.0, neginf=0.0).abs().amax())
    a, b = torch.broadcast_tensors(a, b)
    return torch.allclose(a, b, rtol=share, atol=least, equal_nan=True)
