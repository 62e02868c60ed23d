"""Small vibrations of a rod about an equilibrium: its linearised equations by collocation, as a
quadratic eigenproblem.

Unknowns are the displacement dr, the turn dphi (spatial: dR = ~dphi R) and the changes dn, dm of
force and moment at Chebyshev points of each part, (12) each; the equations hold at Gauss points,
one fewer. Where the stress depends on the strain rate, or forgets, the changes of the strain at
the Gauss points are unknowns too, and those of what arms have crept by. Derivatives of the
equations of a point are complex steps, exact to rounding (Squire and Trapp 1998).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .rod import Point, at_node, carried, rates, strain
from .rotations import Array, back, skew, turn
from .statics import Equilibrium

POINTS = 18  # of each part
STEP = 1e-30
MOTION = ("r", "phi", "v", "w", "a", "alpha")


def eigenvalues(at: Equilibrium, points: int = POINTS) -> Array:
    """(n,) complex 1/s with imaginary part >= 0, by frequency; those of the fastest vibrations,
    among them, are not right.
    """
    K, D, M, moving = pencil(at, points)
    # of the eigenvalues, to shift a rigid motion off 0
    scale = np.sqrt(np.linalg.norm(K[:, moving]) / np.linalg.norm(M))
    shift = 1e-4 * scale
    shifted = np.linalg.inv(_padded(K, moving, D, M, shift))
    A, B = (-(shifted @ x)[moving] for x in (D + 2 * shift * M, M))
    n = moving.size
    # x = mu (A + mu B) ... with mu = 1/(lambda - shift): mu^2 x = (mu A + B) x
    companion = np.block([[A, B], [np.eye(n), np.zeros((n, n))]])
    mu = np.linalg.eigvals(companion)
    mu = mu[np.abs(mu) > 1e-12 * np.abs(mu).max()]
    eigenvalues = shift + 1 / mu
    return eigenvalues[eigenvalues.imag >= -1e-9 * scale][
        np.argsort(eigenvalues.imag[eigenvalues.imag >= -1e-9 * scale], kind="stable")
    ]


def _padded(K: Array, moving: Array, D: Array, M: Array, shift: float) -> Array:
    """K + shift D + shift^2 M, D and M of the columns `moving`."""
    K = K.copy()
    K[:, moving] += shift * D + shift**2 * M
    return K


def pencil(at: Equilibrium, points: int) -> tuple[Array, Array, Array, Array]:
    """K (n, n), D and M (n, m) of K x + lambda D x[moving] + lambda^2 M x[moving] = 0, moving (m,)
    the unknowns in motion.
    """
    case = at.case
    breaks = np.array(case.breaks)
    parts, tau, (shares, times) = len(breaks) - 1, case.damping(), case.arms()
    arms, lossy = shares.shape[1], tau is not None or shares.size > 0
    grid, to, slope = collocation(points)
    width, own = 12 * points, 6 * (points - 1) * (1 + arms) * lossy
    n = parts * (width + own)
    K, D, M = (np.zeros((n, n)) for _ in range(3))
    row = 0
    for k in range(parts):
        h = (breaks[k + 1] - breaks[k]) * case.rod.length
        x = breaks[k] + (breaks[k + 1] - breaks[k]) * (to @ grid + 1) / 2
        (A0, A1, A2), by_strain, stress, S = linear_rates(at, x)
        columns = slice(k * width, (k + 1) * width)
        rows = slice(row, row + 12 * (points - 1))
        spread = np.einsum("gj,ab->gajb", slope * 2 / h, np.eye(12)).reshape(rows.stop - row, width)
        flow = [
            np.einsum("gj,gab->gajb", to, A).reshape(rows.stop - row, width) for A in (A0, A1, A2)
        ]
        if not lossy:
            flow[0] = flow[0] + np.einsum("gj,gab->gajb", to, by_strain @ S @ stress).reshape(
                rows.stop - row, width
            )
        K[rows, columns], D[rows, columns], M[rows, columns] = spread - flow[0], -flow[1], -flow[2]
        row = rows.stop
        if lossy:  # strain - sum share q + S T S^-1 T strain rate = S stress, T^2 = diag(tau)
            first, size = parts * width + k * own, 6 * (points - 1)
            mine, rows = slice(first, first + size), slice(row, row + size)
            K[row - 12 * (points - 1) : row, mine] = -_diagonal(by_strain)
            K[rows, mine] = np.eye(size)
            T, flexible = np.diag(np.sqrt(np.zeros(6) if tau is None else tau)), S[0].diagonal() > 0
            stiff = np.zeros_like(S)
            some = (slice(None), flexible[:, None] & flexible)
            stiff[some] = np.linalg.inv(S[:, flexible][..., flexible]).reshape(len(S), -1)
            D[rows, mine] = _diagonal(S @ T @ stiff @ T)
            K[rows, columns] = -np.einsum("gj,gab->gajb", to, S @ stress).reshape(size, width)
            row = rows.stop
            for i in range(arms):  # time q' + q = strain
                crept = slice(first + (i + 1) * size, first + (i + 2) * size)
                K[rows, crept] = -np.diag(np.tile(shares[:, i], points - 1))
                K[row : row + size, crept], K[row : row + size, mine] = np.eye(size), -np.eye(size)
                D[row : row + size, crept] = np.diag(np.tile(times[:, i], points - 1))
                row += size
    for x in breaks:
        row = _conditions(at, x, list(breaks).index(x), parts, points, (K, D, M), row)
    moving = np.flatnonzero(np.abs(D).sum(0) + np.abs(M).sum(0))
    # unknowns of like size: lengths, forces over EI/L^2
    F0 = 1 / (case.rod.S.diagonal()[3:].max() * case.rod.length**2)
    unit = np.tile(np.repeat((case.rod.length, 1.0, F0, F0 * case.rod.length), 3), parts * points)
    unit = np.concatenate((unit, np.ones(n - unit.size)))
    K, D, M = K * unit, D * unit, M * unit
    size = 1 / np.abs(K).max(1, keepdims=True)
    return size * K, (size * D)[:, moving], (size * M)[:, moving], moving


def collocation(points: int) -> tuple[Array, Array, Array]:
    """Chebyshev points (n,) in [-1, 1], and the matrices (n - 1, n) of values and slopes at the
    Gauss points in between.
    """
    from numpy.polynomial import chebyshev, legendre

    grid = -np.cos(np.pi * np.arange(points) / (points - 1))
    inner = legendre.leggauss(points - 1)[0]
    fit = np.linalg.inv(chebyshev.chebvander(grid, points - 1))
    slopes = np.stack(
        [chebyshev.chebval(inner, chebyshev.chebder(row)) for row in np.eye(points)], -1
    )
    return grid, chebyshev.chebvander(inner, points - 1) @ fit, slopes @ fit


def linear_rates(at: Equilibrium, x: Array) -> tuple[list[Array], Array, Array, Array]:
    """Derivatives of [r', R kappa, n', m'] (g, 12, .) at x (g,): by [dr, dphi, dn, dm], their rates
    and second rates; by the strain (g, 12, 6); of the stress [F; M] by the first (g, 6, 12); and
    the compliance (g, 6, 6).
    """
    case = at.case
    r, R, n, m = at.at(x)
    p = carried(case, x, r, R)
    eps = strain(case, p, n, m)

    def local(p: Point, n: Array, m: Array, eps: Array) -> tuple[Array, Array]:
        along, kappa, n_s, m_s = rates(case, p, eps, n)
        return (
            np.concatenate((along, turn(R, kappa), n_s, m_s), -1),
            np.concatenate((back(p.R, n), back(p.R, m)), -1),
        )

    by = {
        name: _columns(lambda d, name=name: local(moved(p, name, d), n, m, eps)[0], r)
        for name in MOTION
    }
    by_n, by_m = (
        _columns(lambda d, i=i: local(p, n + (1 - i) * d, m + i * d, eps)[0], r) for i in (0, 1)
    )
    by_strain = _columns(lambda d: local(p, n, m, eps + d)[0], eps)
    stress = [
        np.zeros((*x.shape, 6, 3)),
        _columns(lambda d: local(moved(p, "phi", d), n, m, eps)[1], r),
        *(_columns(lambda d, i=i: local(p, n + (1 - i) * d, m + i * d, eps)[1], r) for i in (0, 1)),
    ]
    S = case.rod.S / case.rod.thinned(x)[:, None, None]
    zero = np.zeros((*x.shape, 12, 6))
    A0, A1, A2 = _by_moves(by, p.frame[1])
    A0 = np.concatenate((A0, by_n, by_m), -1)
    return (
        [A0, *(np.concatenate((A, zero), -1) for A in (A1, A2))],
        by_strain,
        np.concatenate(stress, -1),
        S,
    )


def _by_moves(by: dict[str, Array], omega: Array) -> tuple[Array, Array, Array]:
    """By [dr, dphi] and their first and second rates in frame a, from derivatives by absolute
    motion: dv = dr_t + omega x dr, dw = dphi_t, da = dr_tt + 2 omega x dr_t + omega x (omega x dr),
    dalpha = dphi_tt + omega x dphi_t.
    """
    W = skew(omega)
    return (
        np.concatenate((by["r"] + by["v"] @ W + by["a"] @ W @ W, by["phi"]), -1),
        np.concatenate((by["v"] + 2 * by["a"] @ W, by["w"] + by["alpha"] @ W), -1),
        np.concatenate((by["a"], by["alpha"]), -1),
    )


def moved(p: Point, name: str, d: Array) -> Point:
    """A point with a little (..., 3) more of one of its motions."""
    if name == "phi":
        return replace(p, R=p.R + skew(d) @ p.R)
    return replace(p, **{name: getattr(p, name) + d})


def _columns(function: Callable[[Array], Array], like: Array) -> Array:
    """Derivative (..., rows, n) by n numbers, `like` (..., n), by complex steps."""
    steps = 1j * STEP * np.eye(like.shape[-1])
    return np.stack([function(np.zeros_like(like) + step).imag / STEP for step in steps], -1)


def _diagonal(blocks: Array) -> Array:
    """Block diagonal matrix of (g, a, b)."""
    g, a, b = blocks.shape
    matrix = np.zeros((g, a, g, b))
    matrix[np.arange(g), :, np.arange(g), :] = blocks
    return matrix.reshape(g * a, g * b)


def _conditions(
    at: Equilibrium,
    x: float,
    k: int,
    parts: int,
    points: int,
    matrices: tuple[Array, ...],
    row: int,
) -> int:
    """Rows of the place x: what holds it, what joins two parts, what acts there. Returns the next
    row.
    """
    case = at.case
    r, R, _, _ = at.at(x)
    p = carried(case, x, r, R)
    by = {
        name: _columns(
            lambda d, name=name: np.concatenate(at_node(case, x, moved(p, name, d)), -1), r
        )
        for name in MOTION
    }
    loads = _by_moves(by, p.frame[1])
    before = None if k == 0 else 12 * (k * points - 1)
    after = None if k == parts else 12 * k * points
    K = matrices[0]
    first = before if before is not None else after
    held = case.supports[x].held if x in case.supports else np.zeros(6, dtype=bool)
    if before is not None and after is not None:
        for i in range(6):
            K[row + i, before + i], K[row + i, after + i] = 1, -1
        row += 6
    for i in range(6):
        if held[i]:
            K[row, first + i] = 1
        else:  # n after - n before + load = 0
            if after is not None:
                K[row, after + 6 + i] = 1
            if before is not None:
                K[row, before + 6 + i] -= 1
            for matrix, load in zip(matrices, loads, strict=True):
                matrix[row, first : first + 6] += load[i]
        row += 1
    return row
