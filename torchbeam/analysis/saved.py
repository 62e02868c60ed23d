"""save and load: states and solutions in files, to go on from later."""

from __future__ import annotations

from dataclasses import fields, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch._C import _functorch as functorch

from ..core import files
from ..core.arguments import instance
from ..core.function_dependencies import Dependencies
from ..core.validation import broadcast
from ..scene.scene import Scene
from ..state.instant import Instant
from ..state.solution import Solution, Stats
from ..state.state import State
from ..state.state_check import of_mesh

KIND, FORMAT = "torchbeam state", 1


def save(what: Any, path: str | Path, *, scene: Scene | None = None) -> Path:
    """Write a state or a solution into a file, whole or not at all; `load` reads it. The file holds
    numbers and names, no code, and no gradient.

    Args:
        what: a state of any form, or a `Solution`
        path: any name, in an existing folder
        scene: scene of the state: the file keeps digests of it, no copy. `load` with another scene
            then names the differences

    Returns:
        The path.

    Raises:
        ValueError: for another type, a state of another scene, a missing folder, or within a
            transform of torch.func.
        NotWritten: (an OSError) where the disk is full.

    Examples:
        >>> first = tb.simulate(scene, [0.0, 0.1], step=0.01)
        >>> path = tb.save(first.state[-1], "start.pt", scene=scene)
        >>> again = tb.simulate(scene, [0.1, 0.2], tb.load(path, scene=scene), step=0.01)
    """
    path = files.file_of("path", path)
    if not isinstance(what, Instant | Solution):
        raise ValueError(
            f"{type(what).__name__} was given to save; a state or a Solution is wanted"
        )
    if scene is not None:
        _fits(what, instance("scene", scene, Scene))
    files.folder(path.parent)
    if functorch.is_functorch_wrapped_tensor(what.nodes):
        raise ValueError(
            "save within a transform of torch.func was asked for, where there are no numbers; the "
            "result of the transform is wanted"
        )
    content = {KIND: FORMAT, "what": _plain(what), "digests": scene and _digests(scene)}
    files.save(path, content)
    return path


def load(path: str | Path, *, scene: Scene | None = None) -> Any:
    """Read the state or `Solution` of a file that `save` wrote, onto the CPU or the scene's device.
    A run that continues from a state equals an uninterrupted run to the bit, by the same engine and
    steps of a constant length. Its `work` and `energy.work` count from there. Two cases agree to
    rounding only: a plane whose sections `up=` turns by a quarter, and eager steps from an inclined
    support. Adaptive steps start anew.

    Args:
        scene: scene to compare with, in shape. A file that was saved with its scene is compared in
            every number and function

    Raises:
        ValueError: for another file, and for a scene that differs: it names the difference. To
            start another scene from a state, load it without `scene=`.

    Examples:
        >>> path = tb.save(solution, "run.pt")
        >>> tb.load(path).tip.position.shape
        torch.Size([6, 3])
    """
    path = files.path_of("path", path)
    if path.suffix in (".npz", ".mat"):
        raise ValueError(
            f"the file {str(path)!r} was given to load, which reads states and solutions; "
            "torchbeam.Linear.load, or numpy and scipy, is wanted"
        )
    if scene is not None:
        instance("scene", scene, Scene)
    content = files.load(path, KIND, FORMAT, "saved state or solution")
    what, known = content.get("what"), content.get("digests")  # earlier releases have "scene"
    if not _whole(what) or not isinstance(known, dict | None):
        raise ValueError(
            f"the file {str(path)!r} was given, which holds no state or solution of this version; "
            "one is wanted"
        )
    if scene is None:
        return what
    what = _map(lambda x: x.to(scene.device), what)
    _fits(what, scene)
    digests = {} if known is None else _digests(scene)
    differ = [
        name
        for name, digest in digests.items()
        if None not in (known.get(name, ""), digest) and known.get(name, "") != digest
    ]
    if differ:
        raise ValueError(
            f"the file {str(path)!r} was saved with another scene: its {' and '.join(differ)} "
            "differ; the same is wanted, or none, to start another scene"
        )
    return what


def _map(function: Any, what: Any) -> Any:
    """A state, or a solution whose states are all made, with a function of its tensors."""
    if isinstance(what, Instant):
        return what.map(function)

    def own(x: Any) -> Any:
        if isinstance(x, Tensor):
            return function(x)
        if hasattr(x, "_fields"):
            return type(x)(*map(own, x))
        return x.map(function) if isinstance(x, Instant) else x

    stats = replace(
        what.stats, **{f.name: own(getattr(what.stats, f.name)) for f in fields(what.stats)}
    )
    return Solution(own(what.t), own(what.state), own(what.energy), stats, own(what.event))


def _whole(what: Any) -> bool:
    """Whether this is a state or a solution with the fields that it has in this version: those of
    a file are put in their places unseen.
    """
    if not isinstance(what, Instant | Solution):
        return False
    names = {f.name for f in fields(what)}
    if not vars(what).keys() <= names or not all(hasattr(what, name) for name in names):
        return False
    return isinstance(what, Instant) or (isinstance(what.stats, Stats) and _whole(what.state))


def _plain(what: Any) -> Any:
    """Without gradient, and without the rest of what its tensors are parts of."""
    return _map(lambda x: x.detach().clone(memory_format=torch.contiguous_format), what)


def _fits(what: Any, scene: Scene) -> None:
    """ValueError where a state is not one of the scene's."""
    state = what.state if isinstance(what, Solution) else what
    if isinstance(state, State):
        of_mesh(state, scene, "a state")
        if state.parts != scene.beam.parts:
            ours = ", ".join(part.name for part in scene.beam.parts) or "no parts"
            theirs = ", ".join(part.name for part in state.parts) or "no parts"
            raise ValueError(f"a state with {theirs} was given; the scene has {ours}")
    elif state.nodes.shape[-2] != scene.beam.node_count:
        raise ValueError(
            f"a state with {state.nodes.shape[-2]} nodes was given; the beam has "
            f"{scene.beam.node_count}"
        )
    one = state[0] if isinstance(what, Solution) else state
    broadcast("a scene and a state", scene.batch_shape, one.batch_shape)


def _digests(scene: Scene) -> dict[str, str | None]:
    """A digest of each field of a scene; None of one with functions that are not seen whole."""
    digests: dict[str, str | None] = {}
    for field in fields(scene):
        value = getattr(scene, field.name)
        around = Dependencies([(field.name, lambda value=value: value)], strict=False)
        text = repr(sorted(around.digests().items()))
        digests[field.name] = None if around.unseen else sha256(text.encode()).hexdigest()
    return digests
