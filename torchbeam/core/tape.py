"""Tape: the torch operations by which a function of tensors gave others, to be made again with
other numbers, without the Python around them.

What Python took of the numbers on the way (a truth value, an equality) is a condition of the tape:
where numbers say otherwise it gives nothing. (Tracing with guards: Ansel and others, 2024,
https://doi.org/10.1145/3620665.3640366.)
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

# what tensors are asked for that those of other numbers give alike
# fmt: off
SHARED = {
    "shape", "ndim", "dtype", "device", "layout", "requires_grad", "is_leaf", "is_cpu", "is_cuda",
    "size", "dim", "numel", "nelement", "stride", "storage_offset", "element_size", "is_inference",
    "is_floating_point", "is_complex", "is_contiguous", "__len__",
}
# fmt: on
SWITCH = "_set_grad_enabled"  # changes no number
WRITES = {"__setitem__", "__iadd__", "__isub__", "__imul__", "__itruediv__"}
PLAIN = (bool, int, float, str)
LITERAL = (*PLAIN, slice, tuple, list, type(None), type(...), torch.dtype)

Tape = Callable[..., tuple[Tensor, ...] | None]


class Otherwise(Exception):
    """What an operation of a tape raises where numbers say otherwise than those recorded."""


class Line(NamedTuple):
    """A line of Python that gives the tensor `name`; "" = it is wanted for what it does. needs:
    names of tensors in it.
    """

    text: str
    name: str
    needs: list[str]


class Recording(TorchFunctionMode):
    """Notes what torch is asked for within it by this thread, of `inputs` and what comes of them.

    spoilt  why there is no tape, in words: a tensor comes from elsewhere or is written to, or what
            was taken of one is no plain value; None = there is one
    """

    def __init__(self, inputs: Sequence[Tensor]) -> None:
        super().__init__()
        names = [f"x{k}" for k in range(len(inputs))]
        self._head = f"def tape({', '.join(names)}):"
        self._names = dict(zip(map(id, inputs), names, strict=True))
        twice = len(self._names) < len(names)
        self.spoilt = "an input stands in two places" if twice else None
        self._held: list[Any] = [*inputs]  # their ids stay their own
        self._lines: list[Line] = []
        self._constants: dict[str, Any] = {}
        self._words: dict[Any, str] = {}  # names of constants
        self._made: dict[str, str] = {}  # name of a tensor, by the text that gives it
        self._writes = self._merged = self.silent = False
        self._numbers = count()

    def __torch_function__(
        self, call: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None
    ) -> Any:
        kwargs = kwargs or {}
        result = call(*args, **kwargs)
        if not self.silent and self.spoilt is None:
            self.note(call, args, kwargs, result)
        return result

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Nothing is noted."""
        self.silent = True
        try:
            yield
        finally:
            self.silent = False

    def note(self, call: Any, args: Sequence[Any], kwargs: dict[str, Any], result: Any) -> None:
        """That call(*args, **kwargs) has given the result: tensors, or a plain value."""
        of = call.__self__ if call.__name__ == "__get__" else call
        word, made = of.__name__, [*_tensors(result)]
        if word == SWITCH or (word in SHARED and not made):
            return
        if word == "detach":  # a tape records no derivatives
            self._name(result, self._names.get(id(args[0]), ""))
            return
        needs: list[str] = []
        parts = [self._word(x, needs) for x in args]
        parts += [f"{key}={self._word(x, needs)}" for key, x in kwargs.items()]
        text = f"{self._constant(call)}({', '.join(parts)})"
        if word in WRITES or (word.endswith("_") and not word.endswith("__")):
            if self._merged or not parts[0].startswith("v"):
                self.spoilt = f"{word} writes to a tensor that is not the tape's alone"
            self._writes = True
            self._lines.append(Line(text, "", needs))
        elif "out" in kwargs or not (made or _plain(result)):
            self.spoilt = f"{word} gave {type(result).__name__}"
        elif made:
            name = None if self._writes else self._made.get(text)  # computed before
            self._merged = self._merged or name is not None
            if name is None:
                name = self._made[text] = f"v{next(self._numbers)}"
                self._lines.append(Line(f"{name} = {text}", name, needs))
            self._name(result, name)
        else:
            text = f"if {text} != {self._constant(result)}: return None"
            self._lines.append(Line(text, "", needs))

    def hold(self, x: Any) -> None:
        """Take tensors in x, which follow from no input, as constants."""
        if isinstance(x, Tensor):
            self._held.append(x)
            self._names.setdefault(id(x), self._constant(x))
        elif isinstance(x, (tuple, list)) or hasattr(x, "__dict__"):
            for part in x if isinstance(x, (tuple, list)) else vars(x).values():
                self.hold(part)

    def tape(self, outputs: Sequence[Tensor]) -> Tape | None:
        """A function from tensors in the place of the inputs to those in the place of `outputs`, or
        to None where numbers say otherwise than those recorded; None where there is none.
        """
        needs: list[str] = []
        words = [self._word(x, needs) for x in outputs if self.spoilt is None]
        if self.spoilt is not None:
            return None
        results = "".join(f"{word}, " for word in words)
        wanted, body = {*needs}, []
        for line in reversed(self._lines):
            if not line.name or line.name in wanted:
                body.append(f"    {line.text}")
                wanted.update(line.needs)
        text = "\n".join([self._head, *reversed(body), f"    return ({results})"])
        scope = dict(self._constants)
        exec(text, scope)

        def tape(*tensors: Tensor) -> tuple[Tensor, ...] | None:
            try:
                return scope["tape"](*tensors)
            except Otherwise:
                return None

        return tape

    def _name(self, result: Any, name: str) -> None:
        if isinstance(result, Tensor):
            self._held.append(result)
            self._names.setdefault(id(result), name)
            return
        for k, part in enumerate(result):
            self._name(part, f"{name}[{k}]")

    def _word(self, x: Any, needs: list[str]) -> str:
        if isinstance(x, Tensor):
            if id(x) not in self._names and any(x is one for one in _of_modules()):
                self.hold(x)
            name = self._names.get(id(x), "")
            if not name:
                self.spoilt = f"a tensor {tuple(x.shape)} comes from elsewhere"
            needs.append(name.partition("[")[0])
            return name
        if not [*_tensors(x)]:
            return self._constant(x)
        if type(x) not in (tuple, list):
            self.spoilt = f"a {type(x).__name__} of tensors was given"
        return f"({''.join(f'{self._word(part, needs)}, ' for part in x)})"

    def _constant(self, x: Any) -> str:
        key = repr(x) if isinstance(x, LITERAL) else id(x)
        name = self._words.setdefault(key, f"c{len(self._words)}")
        self._constants[name] = x
        return name


def current_recording() -> Recording | None:
    """The one that notes what torch is asked for in this thread."""
    if not torch._C._len_torch_function_stack():
        return None
    modes = torch.overrides._get_current_function_mode_stack()
    return next((x for x in modes if isinstance(x, Recording) and not x.silent), None)


def _of_modules() -> Iterator[Tensor]:
    """Constants of the package: tensors that stand in its modules."""
    package = __name__.partition(".")[0]
    for name, module in [*sys.modules.items()]:
        if name.partition(".")[0] == package:
            yield from (x for x in vars(module).values() if isinstance(x, Tensor))


def _tensors(x: Any) -> Iterator[Tensor]:
    if isinstance(x, Tensor):
        yield x
    elif isinstance(x, slice):
        yield from _tensors((x.start, x.stop, x.step))
    elif isinstance(x, (tuple, list, dict)):
        for part in x.values() if isinstance(x, dict) else x:
            yield from _tensors(part)


def _plain(x: Any) -> bool:
    return isinstance(x, PLAIN) or (isinstance(x, (tuple, list)) and all(map(_plain, x)))
