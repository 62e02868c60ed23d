"""An arm driven by torques, of Elastica-RL-control, for other programs: its numbers, the actions
that are tried, and rows that are measured. Wants NumPy alone, so that a peer may live in an
environment of its own.
"""

import json
import sys
import time
from importlib.metadata import version

import numpy as np

ARM = {
    "length": 1.0,  # m
    "radius": 0.05,  # m
    "young": 1e7,  # Pa; G = E / 1.5, shear stiffness 4/3 G A
    "density": 1000.0,  # kg/m^3
    "elements": 20,
    "viscous": 30.0,  # N s/m^2, and N s
    "torque": 75.0,  # N m at an action of 1, of an element
    "points": [k / 7 for k in range(1, 7)],
    "interval": 1.4e-3,  # s
    "substeps": 7,
}
INTERVALS = 1428  # 2 s
HELD = {"anew in each interval": 1, "held for 0.14 s": 100, "held for 0.7 s": 500}  # intervals
SEEDS = 4


def actions(kind, seed):
    """(interval, 12) uniform in [-1, 1]: six values about the normal, six about the binormal."""
    held = HELD[kind]
    drawn = np.random.default_rng(seed).uniform(-1, 1, (-(-INTERVALS // held), 12))
    return np.repeat(drawn, held, 0)[:INTERVALS]


clock = time.process_time


def measured(package, run):
    run(next(iter(HELD)), 0)
    for kind in HELD:
        for seed in range(1 if "--quick" in sys.argv else SEEDS):
            tip, seconds = run(kind, seed)
            yield {
                "peer": f"{package} {version(package)}",
                "actions": kind,
                "seed": seed,
                "cpu_s": seconds,
                "tip": tip.tolist(),
            }


def show(rows):
    for row in rows:
        print(json.dumps(row), flush=True)
