"""What the library says of a case in the limit of fine meshes, beside the oracle."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from . import scenes
from .balances import balances
from .draws import case as draw_case
from .hinges import Wheel
from .hinges import draw as draw_wheel
from .rod import Case
from .rotations import Array
from .statics import equilibrium
from .vibrations import POINTS, eigenvalues

MESHES = {1: (16, 32, 64), 2: (4, 8, 16), "linked": (16, 32, 64)}
QUARTERS = np.array((0.25, 0.5, 0.75, 1.0))
MODES, DAMPED_MODES = 6, 18
# imaginary part over size; where stress depends on the strain rate much else creeps
OSCILLATES = 0.05
# relative: modes take an infinite stiffness for a very large one, as they say; the fastest feel it
# most
RIGID = 5e-5
STILL = 1e-12  # of the strain energy: a kinetic energy that is none
STEPS, SPAN = 40, 0.5  # of the coarsest motion; in units of sqrt(m L^4/EI)
FLOOR = {
    "statics": 1e-7,
    "vibrations": 2e-7,
    "motion": 1e-7,
    "hinges": 1e-8,
}  # of the oracle itself
# no answer that settles more slowly is taken
CAP = {"statics": 3e-5, "vibrations": 2e-4, "motion": 1e-3, "hinges": 3e-4}


@dataclass(frozen=True)
class Comparison:
    """An answer of the library in the limit of fine meshes (and steps): its distance from the
    oracle's, relative to the size of what it is, what is accepted, and by what the mesh's own
    answer still changed.
    """

    net: str
    seed: int
    case: int
    about: str
    quantity: str
    error: float
    tolerance: float
    change: float

    @property
    def ok(self) -> bool:
        return bool(self.error <= self.tolerance)


def limit(values: list[Array], order: int) -> tuple[Array, float]:
    """What three values, by halved elements or steps, tend to (Richardson 1911), and by how much
    the last changed that.
    """
    coarse, fine = ((2**order * b - a) / (2**order - 1) for a, b in itertools.pairwise(values))
    return fine, float(np.abs(fine - coarse).max())


def tolerance(net: str, change: float, own: float = 0.0) -> float:
    """Accepted error: the last change of the extrapolated answer, which a sequence whose changes
    halve or better stays within (of the right order they fall to a fifteenth), the oracle's own,
    and what else is known to be off.
    """
    return min(change + FLOOR[net] + own, CAP[net])


def statics(case: Case) -> list[tuple[str, float, float, float]]:
    """(quantity, error, tolerance, change): positions over the length, axes, and reactions over the
    largest of them.
    """
    solution = equilibrium(case)
    r, R, _, _ = solution.at(QUARTERS)
    exact = {"position": r, "axes": R}
    held = [x for x, support in sorted(case.supports.items()) if support.held.any()]
    if held:
        exact["reaction"] = np.stack([solution.reaction(x) for x in held])
    L = case.rod.length
    F0 = 1 / (case.rod.S.diagonal()[3:].max() * L**2)
    size = {
        "position": L,
        "axes": 1.0,
        "reaction": max(F0 * min(L, 1.0), *np.abs(exact.get("reaction", 0.0)).flatten(), 0.0),
    }
    meshes = [scenes.static(case, N)[1] for N in MESHES[case.order]]
    rows = []
    for name, value in exact.items():
        here, change = limit(
            [mesh[name] / size[name] for mesh in meshes], 4 if case.order == 2 else 2
        )
        error = float(np.abs(here - value / size[name]).max())
        rows.append((name, error, tolerance("statics", change), change))
    return rows


def vibrations(case: Case) -> list[tuple[str, float, float, float]]:
    """The eigenvalues that oscillate, each against the oracle's nearest, over its size; and how
    many of the oracle's below the fastest of them are not among them.
    """
    solution = equilibrium(case)
    exact, finer = eigenvalues(solution, POINTS), eigenvalues(solution, POINTS + 6)
    count = MODES if case.damping() is None else DAMPED_MODES
    rigid = not case.rod.S.diagonal().all()
    meshes = [scenes.vibrations(case, (1 + rigid) * N, count) for N in MESHES[case.order]]
    chosen = [value for value in meshes[-1] if value.imag > OSCILLATES * abs(value)][:MODES]
    near = [finer[np.abs(finer - value).argmin()] for value in chosen]
    rows, partners = [], set()
    for i, value in enumerate(near):
        own = [mesh[np.abs(mesh - value).argmin()] for mesh in meshes]
        here, change = limit([np.array(x) for x in own], 4 if case.order == 2 else 2)
        size = abs(value)
        reference = 2 * np.abs(exact - value).min() / size + rigid * RIGID
        rows.append(
            (
                f"eigenvalue {i + 1}",
                abs(here - value) / size,
                tolerance("vibrations", change / size, reference),
                change / size,
            )
        )
        partners.add(int(np.abs(finer - value).argmin()))
    if case.plane is None and chosen:
        # the slowest are those of least size
        top, size = 0.98 * max(x.imag for x in near), 0.98 * np.abs(meshes[-1]).max()
        below = {
            i for i, x in enumerate(finer) if OSCILLATES * abs(x) < x.imag < top and abs(x) < size
        }
        rows.append(
            (
                "eigenvalues missing",
                float(len(below - partners) + len(chosen) - len(partners)),
                0.0,
                0.0,
            )
        )
    return rows


def motion(case: Case) -> list[tuple[str, float, float, float]]:
    """`motion_by` three meshes, or, where these are too coarse to tell, by ones twice as fine: what
    is wrong in the limit stays, what a mesh leaves out falls to a sixteenth.
    """
    meshes = tuple(N // (1 if case.order == 2 else 2) for N in MESHES[case.order])
    rows = motion_by(case, meshes)
    if all(error <= accepted for _, error, accepted, _ in rows):
        return rows
    return motion_by(case, tuple(2 * N for N in meshes), 2 * STEPS)


def motion_by(
    case: Case, meshes: tuple[int, ...], steps: int = STEPS, span: float = SPAN
) -> list[tuple[str, float, float, float]]:
    """What is left of each balance, and energies and work beside the library's, over the largest
    term in them; steps: of the first mesh, twice as many of the next. No rows of a case in which
    nothing moves the rod from its equilibrium: there all terms are rounding.
    """
    span = span * np.sqrt(case.rod.mass) * case.rod.length**2
    differences: dict[str, list[Array]] = {}
    for k, N in enumerate(meshes):
        moving, said = scenes.motion(case, N, span, steps * 2**k)
        own = balances(moving)
        size = own.pop("size")
        if own["kinetic"].max() <= STILL * np.abs(own["strain"]).max():
            return []
        for name, value in own.items():
            if name in said:
                value = (value - value[0] - said[name] + said[name][0]) / size
            differences.setdefault(name, []).append(value[:: 2**k])
    rows = []
    for name, values in differences.items():
        left, change = limit(values, 2)
        rows.append((name, float(np.abs(left).max()), tolerance("motion", change), change))
    return rows


NETS = {"statics": statics, "vibrations": vibrations, "motion": motion}


def hinges(
    wheel: Wheel, span: float = 3.0, steps: int = 3000
) -> list[tuple[str, float, float, float]]:
    """Angle, rate, hysteretic variable and energy lost of a wheel, over the largest of each. Where
    it yields and turns back the error is of second order with a factor that jumps from step to
    step: what the last halving changed is accepted, and a quarter of the change before.
    """
    exact = wheel.motion(np.linspace(0, span, 26))
    runs = [scenes.turning(wheel, span, steps * 2**k)[:: steps * 2**k // 25] for k in range(3)]
    size = np.abs(exact).max(0)
    first, last = (np.abs(b - a).max(0) / size for a, b in itertools.pairwise(runs))
    error, rows = np.abs(runs[-1] - exact).max(0) / size, []
    for i, name in enumerate(("angle", "rate", "hysteretic variable", "energy lost")):
        change = float(max(last[i], first[i] / 4))
        rows.append((name, float(error[i]), tolerance("hinges", change), change))
    return rows


def compare(net: str, seed: int, number: int) -> list[Comparison]:
    """The rows of a random case. Raises statics.NotFound where the oracle has no answer."""
    random = np.random.default_rng((seed, number))
    if net == "hinges":
        wheel = draw_wheel(random, number)
        return [Comparison(net, seed, number, str(wheel.law), *row) for row in hinges(wheel)]
    case = draw_case(random, number, moving=net == "motion")
    return [Comparison(net, seed, number, case.name, *row) for row in NETS[net](case)]
