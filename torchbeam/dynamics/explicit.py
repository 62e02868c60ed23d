"""ExplicitStepper: one interval at a time by a method of torchdiffeq, in any form of the beam."""

from __future__ import annotations

import warnings
from copy import copy
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import choice, duration, instance, mask
from ..core.batch_subset import BatchSubset
from ..core.functions_of_time import shared
from ..core.status import FAILED, STATUS, SUCCESS, stopped
from ..core.validation import concrete, shown
from ..core.warning import goes, warn
from ..nodal.rates import refuse_forces_between_nodes
from ..scene.effects import Inputs
from ..scene.scene import Scene
from ..state.instant import Instant
from ..state.state import State, rest
from .forms import FORMS, mixed_forms
from .instants import exact, rounded
from .simulate import simulate
from .torchdiffeq_bridge import METHODS as ODE_METHODS
from .torchdiffeq_bridge import AllFailed


class ExplicitStepper:
    """Advances states of a scene by intervals of `dt` seconds with torchdiffeq; called like
    `Stepper`.

    An explicit method needs steps of about 3 over the top frequency of the mesh, so the section
    must be soft. The step of `Stepper` does not depend on the stiffness.

    Args:
        scene: the scene
        dt: s, the interval over which inputs are held
        method: a name of torchdiffeq; a fixed-step one makes options={"step_size": s} steps
        form: "nodal", "minimal" or "block_rate"; states are `State`, or `MixedState` in the two
            mixed forms. Inputs jump between intervals, so each interval starts from a state made
            consistent with its loads
        rtol, atol, options, adjoint, project, solver: as in `simulate`

    Raises:
        ValueError: for an unknown form or method, a dt that is not positive, or a scene that the
            form does not take.

    Examples:
        >>> soft = tb.Section.from_stiffness(
        ...     EA=10.0, GA=4.0, GJ=0.5, EI=1.0, mass=0.3, inertia=0.01
        ... )
        >>> stepper = tb.ExplicitStepper(
        ...     tb.Scene(tb.Beam.straight(1.0, 2, soft)), 0.001, "rk4", form="nodal"
        ... )
        >>> state = stepper(stepper.rest())
        >>> state.t  # s
        tensor(0.0010)
    """

    def __init__(
        self,
        scene: Scene,
        dt: float | Tensor,
        method: str = "rk4",
        form: str = "minimal",
        *,
        rtol: float | None = None,
        atol: float | None = None,
        options: dict[str, Any] | None = None,
        adjoint: bool = False,
        project: bool = False,
        solver: str = "sweep",
    ) -> None:
        instance("a scene", scene, Scene)
        choice("form", form, FORMS)
        if not isinstance(method, str) or method not in ODE_METHODS:
            raise ValueError(
                f"method = {shown(method)} was given; torchdiffeq has {', '.join(ODE_METHODS)}"
            )
        if form == "nodal":
            refuse_forces_between_nodes(scene)
        else:
            mixed_forms().refuse_form(scene, form)
        self.scene, self.form, self.method = scene, form, method
        self.options = dict(
            rtol=rtol, atol=atol, options=options, adjoint=adjoint, project=project, solver=solver
        )
        self.dt = duration("dt", dt, scene.dtype, scene.device)
        self.latest: Tensor | None = None  # (...) s, of the state that was made last
        self.warned = False

    def merge(self, few: BatchSubset, part: ExplicitStepper) -> ExplicitStepper:
        """As `Stepper.merge`: deprecated."""
        goes("ExplicitStepper.merge", "merge the scenes, and make an ExplicitStepper of these")
        merged = copy(self)
        merged.scene = few.merge(self.scene, part.scene)
        return merged

    def rest(self, batch_shape: tuple[int, ...] | None = None) -> Instant:
        """The beam undeformed and at rest, under inputs of zero."""
        shape = torch.Size(self.scene.batch_shape if batch_shape is None else batch_shape)
        if self.form == "nodal":
            return rest(self.scene, shape)
        return mixed_forms().rest(self.scene, self.form, shape)

    def __call__(self, state: Instant, *, active: Tensor | None = None, **inputs: Any) -> Instant:
        """The state one interval later; `active`, a failing sample and status as in `Stepper`."""
        after = self.advance(state, inputs, active)
        lost = concrete((after.status != SUCCESS) & (state.status == SUCCESS))
        if not self.warned and lost.any():
            self.warned = True
            warn(stopped(lost, concrete(after.t), STATUS[int(concrete(after.status)[lost][0])]))
        return after

    def advance(self, state: Instant, inputs: Inputs, active: Tensor | None = None) -> Instant:
        """The same, without a warning."""
        values = self.scene.tensors(inputs)
        moving = state.status == 0
        if active is not None:
            moving = moving & mask("active", active, moving)
        now = exact(state.t, self.latest)
        begin, options = shared(now, moving), {}
        if begin.ndim:  # each sample's own
            begin, options = now.new_zeros(()), dict(begin=begin.to(self.dt))
        span = torch.stack((begin, begin + self.dt))
        # who rests need not be on supports now
        start = replace(state, status=torch.where(moving, state.status, FAILED))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a status says it
            try:
                run = simulate(
                    self.scene,
                    span,
                    start,
                    self.method,
                    form=self.form,
                    inputs=values,
                    **self.options,
                    **options,
                )
            except AllFailed:
                return replace(state, status=torch.where(moving, FAILED, state.status))
        good = moving & (run.status == 0)
        after = run.state[-1]
        if isinstance(state, State):  # a run counts the work from its own start
            after = replace(after, work=state.work + after.work)
        self.latest = rounded(torch.where(good, now + self.dt, now), state.t.dtype)
        return replace(
            after.where(good, state),
            t=self.latest,
            status=torch.where(moving, run.status, state.status),
        )
