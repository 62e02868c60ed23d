"""Methods: the implicit ones, by name; generalized_alpha is one solve a step, of
`GeneralizedAlphaProblem`.
"""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from ..core.arguments import boolean
from ..core.leaves import wants_gradient
from ..core.validation import concrete, refusal, shown
from ..equations.generalized_alpha import AlphaState, GeneralizedAlphaProblem
from ..nodal.model import Model
from ..state.state import State
from .method import Method, Midpoint
from .midpoint4 import Midpoint4


class GeneralizedAlphaMethod(Method):
    """One such step; a state that comes without accelerations starts with the mean rates of a trial
    step by "midpoint".
    """

    PROBLEM = GeneralizedAlphaProblem
    SOLVES = "generalized_alpha"

    @classmethod
    def of(cls, name: str, conserve: bool, rho_inf: float | None) -> GeneralizedAlphaMethod:
        if boolean("conserve", conserve):
            raise ValueError(
                "conserve was given; generalized_alpha loses energy by design ('midpoint' takes it)"
            )
        rho = 0.8 if rho_inf is None else rho_inf
        if isinstance(rho, bool) or not isinstance(rho, (int, float)) or not 0 <= rho <= 1:
            raise refusal(f"rho_inf = {shown(rho_inf)}", "a number from 0 to 1")
        return cls(rho_inf=rho)

    def check(self, model: Model) -> None:
        unfit = {
            "a moving frame": model.scene.frame is not None,
            "a mass off its node": _off_its_node(model),
            "a load with internal states": model.internal_states > 0,
            "a joint with damping or friction": model.joints.dissipative,
            "a joint with inertia": model.joints.inertia is not None,
            "a Tendon with friction": model.tendons.dissipative,
            "contact of beams with friction or damping": model.touching.dissipative,
        }
        for name, present in unfit.items():
            if present:
                raise ValueError(f"{name} was given to generalized_alpha; 'midpoint' takes it")

    def begin(
        self, state: State, model: Model, dt: Tensor, trial: Callable[[State], State]
    ) -> AlphaState:
        if isinstance(state, AlphaState):
            if state.acceleration.shape[-1] == 2 * model.space.unknowns:
                return state
            # it remembers in the coordinates of another space, of a plane or not
            state = state.plain()
        after = trial(state)
        reduced = map(model.space.to_reduced, (state, after))
        before, end = (model.strain(model.kinematics(s.position, s.rotation)) for s in reduced)
        rates = model.space.motion(after.velocity - state.velocity, after.spin - state.spin)
        return AlphaState.between(state, *rates, end - before, dt)


def _off_its_node(model: Model) -> bool:
    """Whether a centre of mass is, or a derivative asks what comes of moving it off."""
    lever = model.inertia.offset
    if not lever.present:
        return False
    x = concrete(lever.offset)
    return x is not lever.offset or wants_gradient(x) or bool((x != 0).any())


METHODS: dict[str, type[Method]] = {
    "midpoint": Midpoint,
    "midpoint4": Midpoint4,
    "generalized_alpha": GeneralizedAlphaMethod,
}
