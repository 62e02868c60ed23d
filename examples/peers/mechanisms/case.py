"""The two mechanisms for other programs: numbers, references, error, and measured rows. Wants NumPy
alone, so that a peer may live in an environment of its own.
"""

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from statistics import median

import numpy as np

DATA = json.loads(
    (Path(__file__).parents[3] / "studies/data/mechanism_references.json").read_text()
)
EA, GA, EI, MASS, INERTIA = (DATA[name] for name in ("EA", "GA", "EI", "mass", "inertia"))
DAMPING, GRAVITY, DURATION = DATA["damping"], DATA["gravity"], DATA["duration"]
PINS = np.pad(np.array(DATA["linkage"]), ((0, 0), (0, 1)))  # m, of the linkage
PALM, FINGERS, KNUCKLE = DATA["palm"], DATA["fingers"], DATA["knuckle"]
PLACES = {name: np.array(one["places"]) for name, one in DATA["references"].items()}
SPACES = {"four-bar": "plane", "hand": "3D"}
EVERY = DURATION / (len(PLACES["hand"]) - 1)  # s between instants
Run = Callable[[int, float], tuple[np.ndarray, float]]


def finger(k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of a finger: places of its root, knuckle and tip (3, 3) m; its direction and its knuckle's
    axis (3,).
    """
    turn = 2 * np.pi * k / FINGERS["count"]
    outward, up = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([0.0, 0.0, 1.0])
    along = np.sin(FINGERS["spread"]) * outward - np.cos(FINGERS["spread"]) * up
    places = [PALM["radius"] * outward + s * FINGERS["phalanx"] * along for s in range(3)]
    return np.array(places), along, np.cross(up, outward)


def error(name: str, found: np.ndarray) -> float:
    """RMS |place - reference| / RMS |reference - its start| of (time, point, 3) m at all instants,
    or at every second, third, ...
    """
    places = PLACES[name][:: (len(PLACES[name]) - 1) // (len(found) - 1)]
    return float(np.sqrt(((found - places) ** 2).sum() / ((places - places[0]) ** 2).sum()))


def measured(
    package: str, element: str, runs: dict[str, tuple[Run, Sequence[tuple[int, float]]]]
) -> Iterator[dict]:
    """A row of each mechanism's settings (elements a beam, step s), of the first alone with
    --quick: of run(*setting), which gives places at all instants and the CPU seconds that this
    took. After one run to warm up.
    """
    quick = "--quick" in sys.argv
    for name, (run, settings) in runs.items():
        for elements, step in settings[:1] if quick else settings:
            found, first = run(elements, step)
            repeats = 1 if quick else 5 if first < 1 else 2
            seconds = [run(elements, step)[1] for _ in range(repeats)]
            yield {
                "peer": f"{package} {version(package)}",
                "what": name,
                "space": SPACES[name],
                "elements": elements,
                "element": element,
                "step_ms": 1e3 * step,
                "error": error(name, found),
                "best_cpu_s": min(seconds),
                "median_cpu_s": median(seconds),
                "rate": DURATION / min(seconds),
            }


def show(rows: Iterator[dict]) -> None:
    """Print rows; with --json, one JSON object a line."""
    for row in rows:
        numbers = (f"{x:.4g}" if isinstance(x, float) else f"{x}" for x in row.values())
        print(json.dumps(row) if "--json" in sys.argv else "  ".join(numbers), flush=True)


clock = time.process_time
