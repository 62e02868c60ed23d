"""Forms of the beam by name: the nodal one, and the two of the derivation's element."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import torch

FORMS = ("nodal", "minimal", "block_rate")
PACKAGE = "torchbeam.mixed"


def mixed_forms() -> Any:
    """The package of the derivation's element, imported where it is first asked for."""
    return import_module(PACKAGE)


class LoadedMixedState:
    """What a file's `MixedState` is made by: reading it imports the package, with which comes what
    it is loaded into.
    """

    def __new__(cls) -> Any:
        return object.__new__(mixed_forms().MixedState)


torch.serialization.add_safe_globals([(LoadedMixedState, f"{PACKAGE}.state.MixedState")])
