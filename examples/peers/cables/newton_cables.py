"""Newton's own checks of its cables, by the examples that its release contains: what they measure
and what they allow, a JSON object a row. Wants newton 1.8; on the CPU the first run compiles.

Each row has `case`, `measure`, `value` and `bound`: bend and twist between two held ends
(`cable_bend_twist_analytic`), and the link of a cable whose end turns (`cable_twist_buckling`).
"""

import json
import math
import time
from importlib.metadata import version
from types import SimpleNamespace

import newton.viewer
import numpy as np
from newton.examples.vbd import example_cable_bend_twist_analytic as held
from newton.examples.vbd import example_cable_twist_buckling as buckling


def run(module, seconds, **options):
    """The example after so many seconds of motion, and the CPU seconds that these took."""
    example = module.Example(newton.viewer.ViewerNull(), SimpleNamespace(**options))
    example.step()
    start = time.process_time()
    for _ in range(round(seconds * example.fps)):
        example.step()
    return example, time.process_time() - start


def row(case, measure, value, bound, cpu):
    return {
        "peer": f"newton {version('newton')}",
        "case": case,
        "measure": measure,
        "value": float(value),
        "bound": bound,
        "cpu_s": cpu,
    }


def bend_and_twist():
    example, cpu = run(held, 6.5)
    for kind, cases, axis in (("bend", example.bend_cases, 1), ("twist", example.twist_cases, 0)):
        for case in cases:
            angles = example._measure_case_angles(case, axis_index=axis)
            wanted = example._analytic_angles(case["target"])
            off = np.degrees(np.abs(angles) - np.abs(wanted))
            points = example._rod_points(case["bodies"])
            name = f"{kind} by {math.degrees(case['target']):.0f} degrees"
            yield row(name, "end, degrees", abs(off[-1]), 0.005 if axis else 0.02, cpu)
            yield row(name, "rotation, degrees RMS", np.sqrt(np.mean(off**2)), 0.02, cpu)
            if axis:
                away = points - example._analytic_bend_points(case["rest_points"], case["target"])
                shape = np.sqrt((away**2).sum(1).mean()) / example.cable_length
                yield row(name, "shape, L RMS", shape, 2e-5, cpu)
            else:
                across = np.linalg.norm((points - case["rest_points"])[:, 1:], axis=1).max()
                yield row(name, "across, L", across / example.cable_length, 1e-5, cpu)


def link():
    example, cpu = run(buckling, buckling.Example.TOTAL_TIME)
    of = example.link_metrics()
    name = f"{example.twist_turns:.0f} turns of an end"
    yield row(name, "link, turns", abs(of["link_error_turns"]), example.LINK_TOLERANCE_TURNS, cpu)
    distance = of["min_nonlocal_distance_diameters"]
    yield row(name, "least distance, diameters", distance, example.MIN_SELF_DISTANCE_DIAMETERS, cpu)


if __name__ == "__main__":
    for kind in (bend_and_twist, link):
        for printed in kind():
            print(json.dumps(printed), flush=True)
