"""What the suite's references leave out: distances to boundary value problems of the whole rod.

The catenary has no bending stiffness, which moves the cable by 4.7e-4 of its length; a swing's
period is that of linear theory, 2e-5 shorter than at the suite's amplitude. The cable with bending,
shear and stretch is solved here, by `scipy.integrate.solve_bvp` to 1e-10.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from cosseratbench.experiments.catenary import reference_curve
from cosseratbench.scenario import Rod, Scenario
from cosseratbench.trajectory import Trajectory
from scipy.integrate import solve_bvp

SHEAR = 27 / 28  # coefficient of a circular section, as the suite's solvers have it


@cache
def cable(rod: Rod, gravity: float, points: int) -> np.ndarray:
    """(points, 3) m: evenly spaced along a rod that hangs between two pins of the same height.

    With n the force and m the moment in a section of direction d = (cos a, sin a), which shears,

        r' = (1 + N/EA) d + (Q/GA) d_perp,  EI a' = m,  m' = -r' x n,  n' = (0, weight)

    Of the half from a pin to the middle, where a and x are known.
    """
    E, G, A = rod.material.youngs_modulus, rod.material.shear_modulus, rod.area
    EA, GA, EI = E * A, SHEAR * G * A, E * rod.second_moment_of_area
    weight, L = rod.material.density * A * gravity, rod.length
    span = rod.centerline[-1][0] - rod.centerline[0][0]

    def rates(s: np.ndarray, y: np.ndarray, p: np.ndarray) -> np.ndarray:
        _, _, a, moment = y
        H, V = p[0], weight * (s - L / 2)
        c, n = np.cos(a), np.sin(a)
        e, shear = 1 + (H * c + V * n) / EA, (V * c - H * n) / GA
        x, z = e * c - shear * n, e * n + shear * c
        return np.vstack((x, z, moment / EI, H * z - V * x))

    def ends(pin: np.ndarray, middle: np.ndarray, _: np.ndarray) -> np.ndarray:
        return np.array([pin[0], pin[1], pin[3], middle[2], middle[0] - span / 2])

    s = np.linspace(0, L / 2, 601)
    x, _, z = reference_curve(rod, gravity, span, 1201)[:601].T
    H = weight * L / 2 * np.interp(0, s, np.gradient(x, s) / np.abs(np.gradient(z, s)))
    guess = np.vstack((x, z, np.arctan2(np.gradient(z, s), np.gradient(x, s)), 0 * s))
    solution = solve_bvp(rates, ends, s, guess, p=[H], tol=1e-10, max_nodes=50000)
    if not solution.success:
        raise RuntimeError(f"the cable's equations were not solved: {solution.message}")
    at = np.linspace(0, L, points)
    x, z = solution.sol(np.minimum(at, L - at))[:2]
    return np.column_stack((np.where(at > L / 2, span - x, x), 0 * x, z))


def cable_error(scenario: Scenario, trajectory: Trajectory) -> float:
    """Largest distance of a node to its place, in rod lengths."""
    rod, nodes = scenario.rods[0], trajectory.positions[0][-1]
    curve = cable(rod, float(np.linalg.norm(scenario.gravity)), len(nodes))
    return float(np.linalg.norm(nodes - curve, axis=1).max() / rod.length)


MORE: dict[str, dict[str, Callable[[Scenario, Trajectory], float]]] = {
    "catenary": {"error with bending": cable_error}
}
