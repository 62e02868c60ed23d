"""Why no equilibrium of a sample was found."""

from __future__ import annotations

import itertools
import math

import torch

from ..core.derivatives import no_derivatives
from ..core.status import DIVERGED, STATUS
from ..equations.steady import Configuration, SteadyProblem
from ..nodal.deformed_elements import BROKEN, too_deformed
from ..state.state import rest
from .mechanism import unheld
from .rigid_motions import sample_of

SOFT, FAR = 10.0, 1e3  # lengths that loads move a beam by: of a cable; of units that differ, too
CLOSE = 1e-6  # of a length
NOT_FOUND = (
    "Newton's method failed; the load may be past a limit point, which `path` goes through, or the "
    "shape far off: relax=True starts from a damped run, initial=State.from_nodes from your shape"
)
FALL = (
    "Newton's method failed; by linear theory its loads move it by {:.1g} times its length: "
    "relax=True lets so soft a beam fall, as a cable, initial=State.from_nodes starts from a shape"
)
UNITS = "; or the beam has its stiffness and loads in units that differ (Pa, m, N)"
SHEARS = "stretches by shear alone (with GA=inf by nothing)"
SWING = "relax=True lets it swing to where its loads hold it"
NO_REST = "the damped run came to no rest"
DRIVEN = f"{NO_REST}; its loads may drive it on"


def reason(
    problem: SteadyProblem,
    x: Configuration,
    code: int,
    sample: tuple[int, ...] | None,
    relaxed: bool,
) -> str:
    """In words, of a sample with a status `code` whose last shape is in x; sample: None = one of
    many that are alike.
    """
    if code != DIVERGED:
        return STATUS[code]
    if sample is None:
        return DRIVEN if relaxed else NOT_FOUND
    model = problem.model
    with no_derivatives():
        apart = _apart(problem, x, sample)
        loose = unheld(model, problem.t, problem.inputs, sample)[1]
        if apart:
            return apart
        if loose:
            return (
                f"nothing holds {loose}; a support or a spring would "
                f"({DRIVEN if relaxed else SWING})"
            )
        if not relaxed:
            far = _far(problem, sample)
            soft = FALL.format(far) + (UNITS if far > FAR else "")
            return soft if SOFT < far < math.inf else NOT_FOUND
        here = torch.zeros_like(problem.load_factor, dtype=torch.bool)
        here[sample] = True
        deformed = too_deformed(model, x.position, x.rotation, here, BROKEN)
        return DRIVEN if deformed is None else f"{NO_REST}; {deformed}"


def _far(problem: SteadyProblem, sample: tuple[int, ...]) -> float:
    """By how many of its lengths the loads would move it, were displacements small."""
    model = problem.model
    start = model.space.start(rest(model.scene))
    start = Configuration(start.position, start.rotation, torch.zeros_like(start.stress))
    whole = SteadyProblem(model, problem.t, problem.inputs, problem.t.new_ones(()))
    residual, *about = whole.residual(start)
    move = whole.linearise(start, *about).solve(residual.nodes, residual.strain)[0]
    move = sample_of(move[..., : model.space.dims.position], 2, sample)
    return float(move.abs().max() / sample_of(model.scene.beam.length, 1, sample).sum())


def _apart(problem: SteadyProblem, x: Configuration, sample: tuple[int, ...]) -> str:
    """That supports are further from each other than a beam without stretch reaches; "" where none
    are.
    """
    model, p = problem.model, problem.model.space.dims.position
    if not (model.law.rigid and model.space.turns) or model.scene.beam.parts:
        return ""
    S = (
        model.law.S
        if model.law.S.shape[-1] == 1
        else model.law.S.diagonal(dim1=-2, dim2=-1)[..., None]
    )
    none = S[..., :p, 0] == 0
    rigid, unsheared = (sample_of(x, 1, sample) for x in (none[..., 0], none.all(-1)))
    # of a beam without stretch and shear, section axes
    tangent = (model.reference + problem.eigenstrain)[..., :p]
    along = model.length * torch.linalg.vector_norm(tangent, dim=-1, keepdim=True)
    lengths = sample_of(along[..., 0], 1, sample)
    place = sample_of(problem.apply_supports(x).position, 2, sample)
    rigid, unsheared = (x.expand(lengths.shape) for x in (rigid, unsheared))
    fixed = model.constraints.fixed[:, :p]
    ends = sorted(zip(model.constraints.nodes, fixed, strict=True), key=lambda end: end[0])
    for (i, held), (j, also) in itertools.pairwise(ends):
        gap = torch.linalg.vector_norm((place[j] - place[i]) * held * also)
        reach = lengths[i:j].sum()
        if rigid[i:j].all() and gap > (1 + CLOSE) * reach:
            how = "cannot stretch" if unsheared[i:j].all() else SHEARS
            return (
                f"its supports hold nodes {i} and {j} {float(gap):.6g} m apart, and the beam "
                f"between them, which {how}, is {float(reach):.6g} m long"
            )
    return ""
