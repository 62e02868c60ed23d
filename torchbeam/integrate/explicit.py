"""ExplicitStepper: one interval at a time by a method of torchdiffeq, in any form of the beam."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..checks import step_size
from ..mixed.consistent import consistent_state
from ..mixed.state import MixedState
from ..newton import FAILED
from ..scene import Scene
from ..state import State, rest
from .ode import METHODS as ODE_METHODS
from .simulate import FORMS, simulate


class ExplicitStepper:
    """Advances states of a scene by intervals of `dt` seconds with torchdiffeq; called like `Stepper`.

    scene    what is simulated
    dt       s, the interval over which inputs are held
    method   a name of torchdiffeq; a fixed-step one makes options={"step_size": s} steps
    form     "nodal", "minimal" or "block_rate"; states are `State`, or `MixedState` in the two mixed forms. Each interval
             starts from a state made consistent with the loads on it, for inputs jump between intervals
    options  rtol, atol, options, adjoint, solver: as in `simulate`

    An explicit method needs steps of about 3 over the top frequency of the mesh, so it wants a soft section: see `Stepper`
    for one whose step does not depend on the stiffness.

    Raises ValueError for an unknown form or method, a dt that is not positive, or a scene that the form does not take.
    """

    def __init__(self, scene: Scene, dt: float, method: str = "rk4", form: str = "minimal", **options: Any) -> None:
        if form not in FORMS:
            raise ValueError(f"form = {form!r} was given; {', '.join(map(repr, FORMS))} are there")
        if method not in ODE_METHODS:
            raise ValueError(f"method = {method!r} was given; torchdiffeq has {', '.join(ODE_METHODS)}")
        self.scene, self.form, self.method, self.options = scene, form, method, options
        self.dt = torch.as_tensor(step_size("dt", dt), dtype=scene.dtype, device=scene.device)

    def rest(self, batch_shape: tuple[int, ...] | None = None) -> State | MixedState:
        """The beam undeformed and at rest, under inputs of zero."""
        shape = torch.Size(self.scene.batch_shape if batch_shape is None else batch_shape)
        if self.form == "nodal":
            return rest(self.scene, shape)
        zero = {name: torch.zeros(*shape, size, dtype=self.scene.dtype, device=self.scene.device)
                for name, size in self.scene.inputs.items()}
        still = torch.zeros(*shape, self.scene.beam.count, 3, dtype=self.scene.dtype, device=self.scene.device)
        return consistent_state(self.scene, u=still, form=self.form, inputs=zero)

    def __call__(self, state: State | MixedState, *, active: Tensor | None = None, **inputs: Any) -> State | MixedState:
        """The state one interval later; `active`, a failing sample and its status as in `Stepper`."""
        given = self.scene.tensors(inputs)
        begin = state.t.detach().amax()
        moving = state.status == 0
        if active is not None:
            moving = moving & torch.as_tensor(active, dtype=torch.bool, device=moving.device)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a status says it
            try:
                run = simulate(self.scene, torch.stack((begin, begin + self.dt)), state, self.method, form=self.form,
                               inputs=given, **self.options)
            except RuntimeError:  # every sample failed
                return replace(state, status=torch.where(moving, FAILED, state.status))
        good = moving & (run.status == 0)
        after = run.state[-1]
        if isinstance(state, State):  # a run counts the work from its own start
            after = replace(after, work=state.work + after.work)
        return replace(after.where(good, state), t=torch.where(good, state.t + self.dt, state.t),
                       status=torch.where(moving, run.status, state.status))
