"""Local functions of a sample in a step: what becomes of its iterations."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...core.status import BROKEN, DIVERGED, SUCCESS
from ...nodal.balance import mixed, scaled, strains
from ...nodal.model import Model
from ...nodal.multipliers import measured
from ...solvers.newton import Length, converged, first_wait, step_length
from .local_problem import Fields


@dataclass(frozen=True)
class SampleFunctions:
    """Functions of a sample of a model; of one of its nodes, elements and multipliers, `part`."""

    model: Model

    def search(
        self,
        square_force: Tensor,
        square_moment: Tensor,
        longest: Tensor,
        iterations: Tensor,
        over: Tensor,
        merit: Tensor,
        share: Tensor,
        waited: Tensor,
        near: Tensor,
        best_near: Tensor,
        **judged: Tensor,
    ) -> Fields:
        """What becomes of the last step, see `Length`; `forth`: which samples do not take it back,
        `still`: which make no other one, `stays`: which do not go to the best; `best_near`: whether
        anything is near enough to touch at the best. judged: what `_converged` takes.
        """
        free = (over == 0) & (iterations > 0) & ~self._converged(longest=longest, **judged)[1]
        free = free & ((near != 0) | (best_near != 0))
        patient = self.model.patient
        waited = torch.where(iterations > 0, waited, first_wait(patient))
        now = square_force * longest.square() + square_moment
        length = step_length(now, merit, share, waited, free, patient)
        outputs = {name: value.to(over) for name, value in length._asdict().items()}
        still, forth = torch.maximum(over, outputs["back"]), 1 - outputs["back"]
        outputs["stays"] = (length.ratio > 0).to(over)
        near = torch.where(length.worse, best_near, near)
        return outputs | {"still": still, "forth": forth, "best_near": near}

    def _converged(
        self,
        exact: Tensor,
        tolerance: Tensor,
        before: Tensor,
        foresee: Tensor | None = None,
        **sizes: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Size of the residual; whether it is small enough, see `converged`. sizes: what `_size`
        takes.
        """
        size = self._size(**sizes)
        if foresee is None and not self.model.smooth:
            foresee = size < 0  # never
        return size, converged(size, before, exact != 0, tolerance, foresee)

    def _size(
        self,
        force: Tensor,
        moment: Tensor,
        strain: Tensor,
        curvature: Tensor,
        left_force: Tensor,
        left_moment: Tensor,
        left_strain: Tensor,
        left_curvature: Tensor,
        total: Tensor,
        longest: Tensor,
        **gaps: Tensor,
    ) -> Tensor:
        """The scaled residual; gaps: the largest gap and turn of constraints, and the size of
        what they connect.
        """
        strain, left = (
            strains(*both, total) for both in ((strain, curvature), (left_strain, left_curvature))
        )
        size = scaled(left_force, left_moment, left, *mixed(force, moment, total, longest), strain)
        return self.with_gaps(size, gaps)

    def judge(
        self,
        before: Tensor,
        over: Tensor,
        done: Tensor,
        status: Tensor,
        iterations: Tensor,
        back: Tensor | None = None,
        ratio: Tensor | None = None,
        **judged: Tensor,
    ) -> Fields:
        """What `newton` asks of an iteration's largest numbers: size of the residual, which samples
        are done or over, iterations, the status of those that are not done (that of the first
        iteration, when `iterations` was 0). judged: what `_converged` takes.
        """
        size, ends = self._converged(before=before, **judged)
        finite = torch.isfinite(size)
        first = torch.where(finite, float(DIVERGED), float(BROKEN))
        going = over == 0
        done = torch.where(going & ends, torch.ones_like(done), done)
        length = None
        if back is not None:
            length = Length(back, back != 0, ratio, back, back, back)
        return {
            "before": size if length is None else length.before(before, size),
            "done": done,
            "over": ((done != 0) | ~finite).to(done),
            "status": torch.where(iterations == 0, first, status),
            "iterations": iterations + going.to(iterations),
        }

    def with_gaps(self, size: Tensor, gaps: Fields) -> Tensor:
        """A scaled residual with the gaps of constraints, if there are any, see `judge`."""
        if not gaps:
            return size
        apart = gaps["gap_position"] / gaps["constraint_size"]
        return measured(size, torch.maximum(apart, gaps["gap_rotation"]))

    def outcome(
        self,
        moving: Tensor,
        done: Tensor,
        status: Tensor,
        before: Tensor,
        cosine: Tensor,
        least: Tensor,
        passed_through: Tensor | None = None,
    ) -> Fields:
        """The status (that of `before` where a sample does not move): it has converged, and no node
        has turned too far or passed through what it is to touch; and whether it moves on.
        """
        lost = cosine < least
        lost = lost if passed_through is None else lost | (passed_through != 0)
        status = torch.where(done != 0, torch.where(lost, float(DIVERGED), float(SUCCESS)), status)
        status = torch.where(moving != 0, status, before)
        return {"status": status, "moving": ((status == SUCCESS) & (moving != 0)).to(moving)}

    def part(self, ratio: Tensor, **fields: Tensor) -> Fields:
        """Unknowns, so much of the way from these to others, `to_` and their names."""
        names = [name for name in fields if f"to_{name}" in fields]
        part = {name: torch.lerp(fields[name], fields[f"to_{name}"], ratio) for name in names}
        return part | ({"m": self.model.space.normalize(part["m"])} if "m" in part else {})
