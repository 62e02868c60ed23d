"""What the suite's references leave out: rods at rest by boundary value problems of the whole rod.

The catenary has no bending stiffness, which moves the cable by 4.7e-4 of its length; ropes that
cross have no shear, and their lift is that of their middle, but is read at the node next to it,
half an element away. Ropes with bending, shear and stretch are solved here, by
`scipy.integrate.solve_bvp` to 1e-10.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from cosseratbench.experiments import catenary, crossing
from cosseratbench.scenario import Rod, Scenario
from cosseratbench.trajectory import Trajectory
from scipy.integrate import solve_bvp
from scipy.optimize import brentq

SHEAR = 27 / 28  # coefficient of a circular section, as the suite's solvers have it


def rope(
    rod: Rod, span: float, gravity: float, load: float, guess: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    """(n, 2) m, along and up from the first pin, of arclengths (n) of a rod between two pins of the
    same height, with a load (N, downwards) on its middle; guess (601, 2) m: half of it.

    With n the force and m the moment in a section of direction d = (cos a, sin a), which shears,

        r' = (1 + N/EA) d + (Q/GA) d_perp,  EI a' = m,  m' = -r' x n,  n' = (0, weight)

    Of the half from a pin to the middle, where a and x are known.
    """
    E, G, A = rod.material.youngs_modulus, rod.material.shear_modulus, rod.area
    EA, GA, EI = E * A, SHEAR * G * A, E * rod.second_moment_of_area
    weight, L = rod.material.density * A * gravity, rod.length

    def rates(s: np.ndarray, y: np.ndarray, p: np.ndarray) -> np.ndarray:
        _, _, a, moment = y
        H, V = p[0], weight * (s - L / 2) - load / 2
        c, n = np.cos(a), np.sin(a)
        e, shear = 1 + (H * c + V * n) / EA, (V * c - H * n) / GA
        x, z = e * c - shear * n, e * n + shear * c
        return np.vstack((x, z, moment / EI, H * z - V * x))

    def ends(pin: np.ndarray, middle: np.ndarray, _: np.ndarray) -> np.ndarray:
        return np.array([pin[0], pin[1], pin[3], middle[2], middle[0] - span / 2])

    s = np.linspace(0, L / 2, len(guess))
    x, z = guess.T
    along, up = np.gradient(x, s), np.gradient(z, s)
    H = (weight * L + load) / 2 * along[0] / abs(up[0])
    turn = np.arctan2(up, along)
    y = np.vstack((x, z, turn, EI * np.gradient(turn, s)))
    solution = solve_bvp(rates, ends, s, y, p=[H], tol=1e-10, max_nodes=50000)
    if not solution.success:
        raise RuntimeError(f"the rope's equations were not solved: {solution.message}")

    def curve(at: np.ndarray) -> np.ndarray:
        x, z = solution.sol(np.minimum(at, L - at))[:2]
        return np.column_stack((np.where(at > L / 2, span - x, x), z))

    return curve


def cable(scenario: Scenario, points: int) -> tuple[np.ndarray, ...]:
    """(points, 3) m: evenly spaced along the rod that hangs between two pins."""
    rod, gravity = scenario.rods[0], float(np.linalg.norm(scenario.gravity))
    span = rod.centerline[-1][0] - rod.centerline[0][0]
    guess = catenary.reference_curve(rod, gravity, span, 1201)[:601, ::2]
    x, z = rope(rod, span, gravity, 0.0, guess)(np.linspace(0, rod.length, points)).T
    return (np.column_stack((x, 0 * x, z)),)


def crossed(scenario: Scenario, points: int) -> tuple[np.ndarray, ...]:
    """(points, 3) m of the lower rope, along x, and of the upper one, along y."""
    rod, gravity = scenario.rods[0], float(np.linalg.norm(scenario.gravity))
    E, drop = rod.material.youngs_modulus, -scenario.rods[1].centerline[0][2]
    middle, span = np.array([rod.length / 2]), crossing.SPAN

    @cache
    def loaded(load: float) -> Callable[[np.ndarray], np.ndarray]:
        s, guess = crossing._elastica(E, load)
        at = np.linspace(0, rod.length / 2, 601)
        guess = np.column_stack([np.interp(at, s, x) for x in guess.T])
        return rope(rod, span, gravity, load, guess)

    def gap(force: float) -> float:
        lower, upper = (float(loaded(x)(middle)[0, 1]) for x in (force, -force))
        return lower - (upper - drop) + 2 * rod.radius

    without_shear = crossing._contact_force(E, drop, crossing._mid_height)
    force = brentq(gap, 0.9 * without_shear, 1.1 * without_shear, xtol=1e-9)
    s = np.linspace(0, rod.length, points)
    (x, low), (y, high) = (loaded(load)(s).T for load in (force, -force))
    lower = np.column_stack((x - span / 2, 0 * x, low))
    return lower, np.column_stack((0 * y, y - span / 2, high - drop))


EXACT: dict[str, Callable[[Scenario, int], tuple[np.ndarray, ...]]] = {
    "catenary": cable,
    "crossing": crossed,
}


def at_rest(name: str, scenario: Scenario, elements: int) -> Trajectory | None:
    """Rods as they should come to rest, where that is known; what the suite makes of it is what its
    own references are off by. Directors are none that it looks at.
    """
    if name not in EXACT:
        return None
    rods = EXACT[name](scenario, elements + 1)
    still = tuple(np.stack((x, x)) for x in rods)
    return Trajectory(np.array([0.0, 1.0]), still, tuple(x[:, 1:] for x in still))


def distance(rest: Trajectory, trajectory: Trajectory) -> float:
    """Largest distance of a node to its place, m."""
    both = zip(rest.positions, trajectory.positions, strict=True)
    return max(float(np.linalg.norm(x[-1] - y[-1], axis=1).max()) for x, y in both)
