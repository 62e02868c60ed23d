"""Tracer: operations of torch on tensors run, and beside them on the nodes of a graph."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch._decomp import decomposition_table

from .arrays import FACTORS_OF_TRANSPOSE, OTHER, STRUCTURAL, UNKNOWN, accumulated
from .decompositions import DECOMPOSED, INSTEAD
from .elementwise import ELEMENTWISE, REDUCTIONS, array, elementwise, reduction
from .graph import Graph
from .readings import Mode, NotTraceable, line, memory, of_user

# of a traced tensor they read the shape alone
FRESH = {
    "zeros_like",
    "ones_like",
    "full_like",
    "empty_like",
    "new_zeros",
    "new_ones",
    "new_full",
    "new_empty",
    "new_empty_strided",
}
# no memory is written
RESHAPED = {"squeeze_", "unsqueeze_", "transpose_", "t_", "swapaxes_", "swapdims_", "detach_"}
CASTS = (torch.float64, torch.float32, torch.int64, torch.int32, torch.bool)


class Tracer(Mode):
    """Runs operations on tensors and, beside them, on the nodes of their elements. Nodes lie beside
    memory, not tensors: for each storage one array, so that views, and writes through them, find
    what they show.
    """

    def __init__(self, captured: set[int]) -> None:
        """captured: memory in whose place inputs stand."""
        super().__init__()
        self.captured, self.graph = captured, Graph()
        # storage -> a tensor on it, which keeps it alive; its nodes, one behind the other
        self.beside: dict[int, tuple[Tensor, np.ndarray]] = {}
        self.fresh: set[int] = set()  # memory of constants that the function made
        self.stopped: set[int] = set()  # of what it detached, which shows the same numbers
        # likewise, of constants made of what carries gradient
        self.differentiable: dict[int, Tensor] = {}

    def traced(self, value: Any) -> bool:
        return isinstance(value, Tensor) and memory(value) in self.beside

    def hold(self, value: Tensor, nodes: np.ndarray) -> None:
        """Write nodes beside a tensor's memory."""
        storage = value.untyped_storage()
        if storage._cdata not in self.beside:
            none = np.full(storage.nbytes() // value.element_size(), UNKNOWN)
            self.beside[storage._cdata] = value, none
        self._shown(value)[...] = nodes

    def _shown(self, value: Tensor) -> np.ndarray:
        first, nodes = self.beside[value.untyped_storage()._cdata]
        size = value.element_size()
        if first.dtype != value.dtype and first.element_size() != size:
            raise NotTraceable(
                f"memory of {first.dtype} was read as {value.dtype} at {line()}; one dtype is "
                "wanted"
            )
        if not value.numel():
            return np.empty(value.shape, np.int64)
        strides = [8 * step for step in value.stride()]
        return np.ndarray(value.shape, np.int64, nodes, 8 * value.storage_offset(), strides)

    def _carries_gradient(self, value: Tensor) -> bool:
        return value.requires_grad or value.untyped_storage()._cdata in self.differentiable

    def nodes(self, value: Tensor | float | bool) -> np.ndarray:
        """int64 of the same shape; what is not traced is constant."""
        if isinstance(value, Tensor) and value._is_zerotensor():
            value = torch.zeros(value.shape)
        if isinstance(value, complex):
            raise NotTraceable(
                f"the number {value} met a traced tensor at {line()}; real numbers are wanted"
            )
        if not isinstance(value, Tensor):
            return array([self.graph.const(value if isinstance(value, bool) else float(value))], ())
        if self.traced(value):
            return self._shown(value)
        if self._carries_gradient(value):
            raise NotTraceable(
                f"a tensor that carries gradient met a traced one at {line()}; it is wanted as "
                "an input"
            )
        if value.is_complex():
            raise NotTraceable(
                f"a tensor of {value.dtype} met a traced one at {line()}; real numbers are wanted"
            )
        return array([self.graph.const(v) for v in value.detach().flatten().tolist()], value.shape)

    def __torch_dispatch__(
        self, func: Any, types: Any, args: tuple = (), kwargs: dict | None = None
    ) -> Any:
        kwargs = dict(kwargs or {})
        tensors, known = _tensors((*args, *kwargs.values())), _operation(func)
        name, traced = known.name, any(map(self.traced, tensors))
        if known.random:
            raise NotTraceable(
                f"random numbers were drawn by {func} at {line()}; numbers that are drawn before "
                "are wanted"
            )
        if self.captured and any(memory(x) in self.captured for x in tensors):
            raise NotTraceable(
                f"{func} at {line()} reads the memory of a parameter by another tensor; the "
                "parameter itself is wanted"
            )
        if name in FRESH or name in RESHAPED:
            return self._made(func(*args, **kwargs), () if name in FRESH else tensors)
        if not traced:
            for k in known.written:
                if k < len(args) and isinstance(args[k], Tensor):
                    self._own(func, args[k])
            out = self._made(func(*args, **kwargs), () if name == "lift_fresh" else tensors)
            if any(self._carries_gradient(x) for x in tensors):
                self.differentiable |= {x.untyped_storage()._cdata: x for x in _tensors(out)}
            return out
        if name == "_linalg_check_errors":
            return None
        if name == "_has_same_storage_numel":  # asked of dual numbers: sizes alone tell
            return func(*args, **kwargs)
        if name in ("_local_scalar_dense", "equal", "is_nonzero", "nonzero", "masked_select"):
            raise NotTraceable(
                f"the value of a traced tensor was asked for by {name.strip('_')} at {line()}; "
                "control flow by values cannot be traced; torch.where in the place of an if, "
                "functions of torch in the place of math's are wanted"
            )
        if name == "detach" and of_user():
            return self._stop(args[0])
        if known.view:
            shown = func(*args, **kwargs)  # a view: its nodes are those of the memory
            if all(self.traced(x) for x in _tensors(shown)):
                if any(x.dtype != args[0].dtype for x in _tensors(shown)):
                    raise self._unknown(func, "it reads numbers by their bits")
                return shown
            return self._decomposed(func, args, kwargs)  # it has made a copy
        written = known.written
        if name in DECOMPOSED and written:
            return self._decomposed(func, args, kwargs)
        if written not in ((), (0,)):
            raise self._unknown(func)
        if written and (not self.traced(args[0]) or memory(args[0]) in self.stopped):
            self._own(func, args[0])
        behind = known.positional[len(args) :]
        last = max((k + 1 for k, (name, _) in enumerate(behind) if name in kwargs), default=0)
        args = [*args, *(kwargs.pop(name, default) for name, default in behind[:last])]
        result = self._applied(func, name.rstrip("_") if written else name, args, kwargs)
        if result is NotImplemented:
            return self._decomposed(func, args, kwargs)
        out = func(*args, **kwargs)
        if written:
            if not self.traced(args[0]):  # all that the memory holds is constant so far
                whole = torch.empty(0, dtype=args[0].dtype).set_(args[0].untyped_storage())
                self.hold(whole, self.nodes(whole))
            self.hold(args[0], result)
            return out
        outs = out if isinstance(out, (tuple, list)) else (out,)
        founds = result if isinstance(result, tuple) else (result,)
        for k, one in enumerate(outs):
            self.hold(one, founds[k] if k < len(founds) else array([UNKNOWN], ()))
        return out

    def _stop(self, x: Tensor) -> Tensor:
        """The same numbers, whose derivatives are 0."""
        stopped = torch.empty_strided(x.shape, x.stride(), dtype=x.dtype, device=x.device).copy_(x)
        self.stopped.add(memory(stopped))
        nodes = self.nodes(x)
        stop = [y if y == UNKNOWN else self.graph.make("stop", y) for y in nodes.ravel().tolist()]
        self.hold(stopped, array(stop, x.shape))
        return stopped

    def _own(self, func: Any, x: Tensor) -> None:
        """Refuses to write to what was there before the function."""
        if memory(x) not in self.fresh:
            raise NotTraceable(
                f"{func} at {line()} writes to a tensor that the function did not make; a function "
                "without memory is wanted"
            )

    def _made(self, out: Any, sources: Sequence[Tensor]) -> Any:
        """What an operation on nothing that is traced gave; its memory is new, where it is none of
        what was given.
        """
        known = {memory(x) for x in sources}
        self.fresh |= {memory(x) for x in _tensors(out)} - known
        return out

    def _decomposed(self, func: Any, args: Sequence, kwargs: dict) -> Any:
        """An operation by the operations that it is composed of, which under inference mode only
        come to light here, or that torch itself knows it by; one that writes by the one that does
        not.
        """
        rule = DECOMPOSED.get(func._schema.name.split("::")[-1])
        with self:
            try:
                result = func.decompose(*args, **kwargs) if rule is None else rule(*args, **kwargs)
            except (NotImplementedError, TypeError) as error:
                raise self._unknown(func, error) from error
            if result is NotImplemented and func in decomposition_table:
                result = decomposition_table[func](*args, **kwargs)
            if result is NotImplemented and func._schema.name.endswith("_"):
                result = args[0].copy_(
                    getattr(torch, func._schema.name.split("::")[-1].rstrip("_"))(*args, **kwargs)
                )
        if result is NotImplemented:
            raise self._unknown(func)
        return result

    def _unknown(self, func: Any, why: object = "") -> NotTraceable:
        instead = INSTEAD.get(func._schema.name.split("::")[-1].rstrip("_"))
        instead = f"; {instead} wanted" if instead else ""
        return NotTraceable(
            f"{func} at {line()} cannot be traced{f': {why}' if why else ''}{instead}"
        )

    def _applied(self, func: Any, name: str, args: list, settings: dict) -> Any:
        """Nodes of an operation's results; NotImplemented where it is not known."""
        graph = self.graph
        settings = {key: value for key, value in settings.items() if value is not None}
        try:
            if name in STRUCTURAL and not (name == "gather" and self.traced(args[2])):
                at = STRUCTURAL[name]
                if any(
                    self.traced(x)
                    for k, arg in enumerate(args)
                    if k not in at
                    for x in _tensors((arg,))
                ):
                    if name in DECOMPOSED:
                        return NotImplemented
                    raise NotImplementedError("places that depend on inputs")
                moved = [self._known(func, arg) if k in at else arg for k, arg in enumerate(args)]
                if name == "index_put" and any(args[3:4]):
                    return accumulated(graph, *moved[:3])
                if _operation(func).name.endswith("_"):
                    moved[0] = moved[0].copy()
                settings = {"memory_format": torch.preserve_format} if name == "clone" else settings
                return func(*map(_as_tensors, moved), **settings).numpy()
            if name == "_to_copy":
                dtype = settings.get("dtype", args[0].dtype)
                if dtype not in CASTS:
                    raise NotImplementedError(
                        f"numbers of {dtype}; torch.float64 or torch.float32 is wanted"
                    )
                rule = (
                    type(graph).truth
                    if dtype == torch.bool
                    else type(graph).number
                    if dtype.is_floating_point
                    else ELEMENTWISE["trunc"]
                )
                return elementwise(graph, rule, self._known(func, args[0]))
            if name in ELEMENTWISE:
                known = [None if x is None else self._known(func, x) for x in args]
                return elementwise(graph, ELEMENTWISE[name], *known, **settings)
            if name == "_linalg_solve_ex":
                settings["transposed"] = FACTORS_OF_TRANSPOSE and args[0].is_contiguous()
            if name == "linalg_lu_solve":
                args = [args[0], args[2]]  # no rows were exchanged
            known = [self._known(func, x) if isinstance(x, Tensor) else x for x in args]
            if name == "fill":
                known[1] = self._known(func, args[1])
            if name in REDUCTIONS:
                return reduction(graph, REDUCTIONS[name], *known, **settings)
            if name in OTHER:
                return OTHER[name](graph, *known, **settings)
        except (NotImplementedError, TypeError) as error:
            raise self._unknown(func, error) from error
        return NotImplemented

    def _known(self, func: Any, value: Any) -> Any:
        """Nodes of an argument, or of a list of them."""
        if isinstance(value, (list, tuple)):
            return [self._known(func, x) for x in value]
        nodes = self.nodes(value)
        if (nodes == UNKNOWN).any():
            raise self._unknown(
                func, "it reads an index, or a factorisation, that depends on inputs"
            )
        return nodes


class _Operation(NamedTuple):
    """What the schema of an operation says: its name without overload; whether it draws random
    numbers, and gives views; the places of the arguments that it writes to; those that may be given
    by place, with their defaults.
    """

    name: str
    random: bool
    view: bool
    written: tuple[int, ...]
    positional: tuple[tuple[str, Any], ...]


@cache
def _operation(func: Any) -> _Operation:
    schema = func._schema
    aliases = [r.alias_info for r in schema.returns]
    return _Operation(
        schema.name.split("::")[-1],
        torch.Tag.nondeterministic_seeded in func.tags,
        bool(aliases) and all(a is not None and not a.is_write for a in aliases),
        tuple(
            k
            for k, a in enumerate(schema.arguments)
            if a.alias_info is not None and a.alias_info.is_write
        ),
        tuple((a.name, a.default_value) for a in schema.arguments if not a.kwarg_only),
    )


def _as_tensors(value: Any) -> Any:
    """An array, or those of a list, as torch has it."""
    if isinstance(value, list):
        return [_as_tensors(x) for x in value]
    return torch.from_numpy(value) if isinstance(value, np.ndarray) else value


def _tensors(value: Any) -> list[Tensor]:
    """Those in a value, and in tuples, lists and dictionaries."""
    if isinstance(value, Tensor):
        return [value]
    if isinstance(value, dict):
        value = tuple(value.values())
    return [x for part in value for x in _tensors(part)] if isinstance(value, (tuple, list)) else []
