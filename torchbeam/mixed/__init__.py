"""Mixed element of the derivation: residuals, index-reduced rates, minimal form. What the library
offers of it is imported from here, where it is asked for: see `torchbeam.dynamics.forms`.
"""

from torch.serialization import add_safe_globals

from ..core.entry_point import entry_points
from .block import BlockRate, block_rate
from .consistent import consistent_state
from .model import refuse_form
from .simulate import rest, simulate_mixed, state_size
from .state import MixedState

__all__ = [
    "BlockRate",
    "MixedState",
    "block_rate",
    "consistent_state",
    "refuse_form",
    "rest",
    "simulate_mixed",
    "state_size",
]

entry_points(globals(), ("BlockRate", "MixedState", "block_rate", "consistent_state"))
# under a name of its own, as that of its module stands for `forms.LoadedMixedState` too
add_safe_globals([(MixedState, "torchbeam.MixedState")])
