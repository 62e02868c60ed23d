"""Rods by collocation: the Cosserat equations of several at once, which SciPy solves between their
ends.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation

import torchbeam as tb

NUMBERS = 10  # of a section: place, quaternion, moment
UNTURNED = (1.0, 0.0, 0.0, 0.0)


class Rod(NamedTuple):
    """Of one section: root m, section axes as columns (along it, across, upwards), length m,
    compliance (6,) 1/N and 1/(N m^2).
    """

    root: np.ndarray
    axes: np.ndarray
    length: float
    compliance: np.ndarray


def rates(rods: Sequence[Rod], y: np.ndarray, forces: np.ndarray, unit: float) -> np.ndarray:
    """By 0 < s < 1 along each, of y (rods NUMBERS, S), whose moments are in unit N m, with the
    forces (rods, 3) in unit N: r' = R (e_1 + gamma), q' = (0, R kappa) q / 2, m' = -r' x n, where
    q turns a rod's axes as drawn.
    """
    slopes = []
    for (_, axes, length, compliance), own, n in zip(rods, by_rod(rods, y), forces, strict=True):
        _, q, m = np.split(own.T, (3, 7), -1)
        R = matrix(q) @ axes
        gamma, kappa = (
            unit * c * np.einsum("sji,sj->si", R, np.broadcast_to(x, m.shape))
            for c, x in ((compliance[:3], n), (compliance[3:], m))
        )
        slope, spin = (R @ (gamma + np.eye(3)[0])[..., None])[..., 0], (R @ kappa[..., None])
        spin, w, v = spin[..., 0], q[:, :1], q[:, 1:]
        turn = -(spin * v).sum(-1, keepdims=True) / 2, (w * spin + np.cross(spin, v)) / 2
        slopes.append(length * np.concatenate((slope, *turn, -np.cross(slope, n)), -1).T)
    return np.concatenate(slopes)


def by_rod(rods: Sequence[Rod], y: np.ndarray) -> np.ndarray:
    """(rods, NUMBERS, ...)"""
    return y.reshape(len(rods), NUMBERS, *y.shape[1:])


def matrix(q: np.ndarray) -> np.ndarray:
    """Of quaternions (..., 4), which collocation may scale: (..., 3, 3)."""
    return Rotation.from_quat(q, scalar_first=True).as_matrix()


def misfit(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(3,) what is 0 where two quaternions are the same turn."""
    (w, *v), (c, *u) = p, q
    return np.multiply(c, v) - np.multiply(w, u) - np.cross(v, u)


def along(rod: Rod, part: tb.State, unit: float, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A beam in a state, as (NUMBERS, S) at those of its nodes that lie at s, and its mean force
    (3,): where a search begins.
    """
    R, stress = part.axes.numpy(), part.stress.numpy() / unit
    N, M = (np.einsum("sij,sj->si", R[1:], x) for x in np.split(stress, 2, -1))
    at = (np.arange(len(M)) + 0.5) / len(M)
    q = Rotation.from_matrix(R @ rod.axes.T).as_quat(scalar_first=True)
    q = q * np.cumprod(np.sign(np.r_[q[:1, 0], (q[1:] * q[:-1]).sum(-1)]))[:, None]
    m = np.stack([np.interp(s, at, x) for x in M.T], -1)
    return np.concatenate((part.position.numpy(), q, m), -1).T, N.mean(0)


def collocated(
    rods: Sequence[Rod],
    forces_of: Callable[[np.ndarray], np.ndarray],
    ends: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
    begin: Sequence[tuple[np.ndarray, np.ndarray]],
    start: np.ndarray,
    unit: float,
    residual: float,
) -> np.ndarray:
    """The last sections (rods, NUMBERS). forces_of: of the unknown forces n, those of all rods;
    ends: first and last sections (rods, NUMBERS) and n to what vanishes; begin: of each rod, see
    `along`; start: n there.
    """
    s = np.linspace(0, 1, begin[0][0].shape[-1])
    done = solve_bvp(
        lambda s, y, n: rates(rods, y, forces_of(n), unit),
        lambda a, b, n: ends(by_rod(rods, a), by_rod(rods, b), n), s,
        np.concatenate([y for y, _ in begin]), start, tol=residual,
    )  # fmt: skip
    if done.status:
        raise RuntimeError(f"collocation of rods has failed: {done.message}")
    return by_rod(rods, done.y[:, -1])
