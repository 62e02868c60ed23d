"""Sorts of what acts between nodes, in one list: whatever goes over them asks it. Each has its
constants, kinds and functions in a file of its own.
"""

from __future__ import annotations

from .coupling_functions import COUPLING
from .joint_functions import JOINT
from .pair_functions import PAIR
from .sorts import ELEMENT, NODE
from .tendon_functions import TIE

INTERACTIONS = JOINT, TIE, PAIR, COUPLING
# in the order in which their balances, and their ends, are gone through
BALANCES = ELEMENT, NODE, TIE, PAIR, COUPLING, JOINT
ENDS = ELEMENT, TIE, PAIR, COUPLING, JOINT, NODE
