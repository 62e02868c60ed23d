"""Known state: the last one that native code has made, which need not be checked and reduced again
to go on from.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

from ..nodal.coordinates.planar import Planar
from ..nodal.coordinates.spatial import Spatial
from ..state.state import State


class StateCache(NamedTuple):
    """The public state; how often its fields had been written to; itself in the space's
    coordinates, None = it is; whether it is known that no sample of it has failed.
    """

    state: Callable[[], State | None]
    versions: tuple[int, ...]
    reduced: State | None
    well: bool

    @classmethod
    def of(cls, state: State, reduced: State, space: Spatial, well: bool) -> StateCache | None:
        """From a public state and itself in the coordinates of a space; None where these do not
        come back from it as they were, or it does not tell whether it is written to.
        """
        same = state is reduced
        reusable = same or (
            isinstance(space, Planar) and space.reversible and not state.position.requires_grad
        )
        versions = _versions(state) if reusable else None
        return (
            None
            if versions is None
            else cls(weakref.ref(state), versions, None if same else reduced, well)
        )

    def if_same(self, state: State) -> StateCache | None:
        """This, with `reduced`, if the state is this one, as it was."""
        if self.state() is not state or self.versions != _versions(state):
            return None
        return self if self.reduced is not None else self._replace(reduced=state)


def _versions(state: State) -> tuple[int, ...] | None:
    """How often each field was written to in place; None = not known, where one was made in
    inference mode (views of a scene's tensors, made there, are not).
    """
    fields = [x for x in vars(state).values() if isinstance(x, Tensor)]
    return None if any(x.is_inference() for x in fields) else tuple([x._version for x in fields])
