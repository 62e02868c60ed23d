"""What is wrong with an implicit step that no smaller one helps: an effect that is not finite, or
jumps, or a motion that neither stiffness nor inertia resists, a null vector of its tangent. Asked
once a run has failed, so that its cost does not matter.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.status import STATUS, SUCCESS, stopped
from ..core.validation import concrete
from ..core.warning import warn
from ..equations.step_problem import StepProblem
from ..math.shapes import broadcast_shapes
from ..nodal.conditions import conditions
from ..nodal.deformed_elements import unsteppable
from ..nodal.element_loads import all_loads
from ..nodal.model import Model
from ..scene.effects import Effect
from ..solvers.newton import newton
from .method import Method
from .step_solver import Span

NONE = 1e-13  # of the largest singular value of a tangent whose rows and columns are of one size
ROUNDING = 1e-6  # of a direction
LARGEST = 1500  # unknowns of a tangent that is looked at
DROWNED = 1e10  # how many times what acts in a joint is what acts elsewhere, where that is lost
RESIST = "a section with rotary inertia, or a support or joint that holds it, is wanted"


def unresisted_motion(problem: StepProblem, failed: Tensor) -> str | None:
    """A sentence on it, of the first sample that `failed` (...), where its step begins; None where
    there is none, or the tangent is too large to be looked at. What acts in a joint may be so large
    that rounding leaves nothing of all else: that is said then.
    """
    model = problem.model
    if model.constraints.count > LARGEST:
        return None
    x = problem.apply_supports(problem.predictor())
    matrix = problem.tangent(x, *problem.residual(x)[1:]).matrix
    free = model.constraints.moving.flatten().nonzero()[:, 0]
    K = _first(matrix.dense(), failed)[free][:, free]
    unit = _first(model.unit[..., None, :], failed).repeat(1, model.node_count)[0, free]
    resistance = (K.abs() * unit * unit[:, None]).amax(-1)
    most, row = resistance.max(-1)
    node = int(free[row]) // model.space.unknowns
    driven = {end for joint in model.scene.joints if joint.acts for end in joint.ends}
    drowned = node in driven and bool(most > DROWNED * resistance.median())
    if model.multipliers.count:
        G = _first(matrix.constraints(), failed)[:, free]
        K = torch.cat((torch.cat((K, G.mT), -1), torch.cat((G, G.new_zeros(len(G), len(G))), -1)))
    size = K.abs().amax(-1).sqrt()
    if not bool(torch.isfinite(size).all()) or not bool((size > 0).all()):
        return None
    _, s, V = torch.linalg.svd(K / size / size[:, None])
    if s[-1] > NONE * s[0]:
        return None
    if drowned:
        return (
            f"what acts in a joint of node {_named(model, node)} is more than {DROWNED:.0e} times "
            f"what acts elsewhere, of which {K.dtype} then keeps nothing; a smaller one is wanted"
        )
    moves = K.new_zeros(model.constraints.moving.numel())
    moves[free] = (V[-1] / size)[: len(free)]
    motion = _words(problem, moves.unflatten(0, (model.node_count, -1)))
    return f"neither stiffness nor inertia resists {motion}; {RESIST}"


def _first(x: Tensor, failed: Tensor) -> Tensor:
    """A matrix of the first sample that failed."""
    place = tuple(concrete(failed).nonzero()[0].tolist())
    return concrete(x).expand(*failed.shape, *x.shape[-2:])[place]


def _words(problem: StepProblem, moves: Tensor) -> str:
    """Of moves (N+1, w): that of the node that turns most, or, where none turns, moves most."""
    model, p = problem.model, problem.model.space.dims.position
    space, eye = model.space, torch.eye(3).to(moves)
    shift = moves[:, :p] @ space.project_vector(eye).mT
    turn = moves[:, p:] @ space.project_spin(eye).mT
    turns = bool(turn.abs().max() * model.scene.beam.extent.max() > shift.abs().max() * NONE**0.5)
    vectors = turn if turns else shift
    node = int(torch.linalg.vector_norm(vectors, dim=-1).argmax())
    direction = vectors[node] / torch.linalg.vector_norm(vectors[node])
    direction = torch.where(
        direction.abs() < ROUNDING, 0.0, direction * direction[direction.abs().argmax()].sign()
    )
    motion = "a rotation about" if turns else "a displacement along"
    axis = ", ".join(f"{v:.3g}" for v in direction.tolist())
    return f"{motion} ({axis}) of node {_named(model, node)}"


def _named(model: Any, node: int) -> str:
    """As the user says it."""
    for part in model.scene.beam.parts:
        if part.nodes.start <= node < part.nodes.stop:
            return repr(part.name if part.body else (part.name, node - part.first_node))
    return str(node)


ITERATES = 6  # of Newton's method that are looked at
# of the way between two of them: what then still changes by half of the whole has a jump
HALVES = 30


class Failure(NamedTuple):
    """A step that has failed: the problem that it solved, and the samples (...) at fault."""

    problem: StepProblem
    failed: Tensor

    def reason(self) -> str | None:
        """One sentence that names the effect at fault; None where none is found."""
        try:
            return self._reason()
        except Exception:
            # of a user's function where it is not used to be asked: the failure itself is to be
            # told
            return None

    def _reason(self) -> str | None:
        with no_derivatives():
            problem, iterates = self.problem, self._iterates()
            for name, value in self._in_time():
                for share in (0.0, problem.INSTANT, 1.0):
                    if not self._finite(value(torch.full_like(problem.start.work, share))):
                        return f"{name} is infinite or not a number"
            for name, value in self._in_motion():
                for x in iterates:
                    if not self._finite(value(x)):
                        return (
                            f"{name} is infinite or not a number at a trial of Newton's "
                            "method; no smaller step may help"
                        )
            for name, value in self._in_motion():
                for a, b in itertools.pairwise(iterates):
                    if self._jumps(lambda s, a=a, b=b, value=value: value(self._between(a, b, s))):
                        return (
                            f"{name} jumps as the beam moves, so that Newton's method does not "
                            "converge and no smaller step helps; let it rise steeply instead "
                            "(torch.tanh(v/v0) for torch.sign(v))"
                        )
            for name, value in self._in_time():
                if self._jumps(value):
                    return (
                        f"{name} jumps in time, and no smaller step helps; let it rise over "
                        "some steps"
                    )
            last = problem.motion.kinematics(iterates[-1].u, iterates[-1].m)
            through = problem.passed_through(last)
            if through is not None and (through & self.failed).any():
                return (
                    "the step leads through what is to be touched; a smaller one may help, or "
                    "contact with a larger force, which holds more energy"
                )
            at = problem.start.position, problem.start.rotation
            if (deformed := unsteppable(problem.model, *at, self.failed)) is not None:
                return deformed
            found = unresisted_motion(problem, self.failed)
            if found is None and problem.model.has_friction:
                return (
                    "what touches sticks or slips within the step, and no balance was found; a "
                    "larger slip_speed, or a smaller step, may help"
                )
            return found

    def _iterates(self) -> list[Any]:
        problem, x = self.problem, self.problem.predictor()
        iterates = [x]
        for _ in range(ITERATES):
            x = newton(problem, x, self.failed, limit=1).x
            iterates.append(x)
        return iterates

    def _in_motion(self) -> Iterator[tuple[str, Callable[[Any], Tensor]]]:
        """The loads (..., N+1, w) that depend on how the beam stands or moves, by the unknowns."""
        problem, model = self.problem, self.problem.model
        for load in (*model.loads[0], *model.scene.interactions):
            now = conditions(model, problem.t, problem.inputs, loads=(load,))
            yield _name(load), lambda x, now=now: all_loads(model, problem.seen(x), now)

    def _in_time(self) -> Iterator[tuple[str, Callable[[Tensor], Tensor]]]:
        """Motions (..., 1, 3 or 7), eigenstrains (..., N or 1, 6) and loads (..., N+1, w), the beam
        as at the start, as functions of the share (...) of the step.
        """
        problem, scene, model = self.problem, self.problem.model.scene, self.problem.model
        start = problem.seen(problem.rest_guess())

        def at(share: Tensor) -> Tensor:
            return problem.t + (share - problem.INSTANT) * problem.dt

        if scene.frame is not None:
            for k, name in enumerate(("velocity", "angular velocity")):
                if model.prescribed_motion.frame(problem.t)[k] is not None:
                    yield (
                        f"the frame's {name}",
                        lambda s, k=k: model.prescribed_motion.frame(at(s))[k][..., None, :],
                    )
        for support in scene.supports:
            if support.moves:
                yield (
                    f"the motion of the support of node {support.node}",
                    lambda s, one=support: torch.cat(
                        _level(*model.prescribed_motion.pose(one, at(s))), -1
                    )[..., None, :],
                )
        for effect in scene.eigenstrains:
            yield (
                _name(effect),
                lambda s, one=effect: one.eigenstrain(
                    at(s), problem.inputs, model.length, scene.beam.element_count
                ),
            )
        for load in (*scene.loads, *scene.interactions):
            yield (
                _name(load),
                lambda s, load=load: all_loads(
                    model, start, conditions(model, at(s), problem.inputs, loads=(load,))
                ),
            )

    def _between(self, a: Any, b: Any, share: Tensor) -> Any:
        share = share[..., None, None]
        u, m, stress = (x + share * (y - x) for x, y in zip(a, b, strict=True))
        return type(a)(u, self.problem.model.space.normalize(m), stress)

    def _finite(self, value: Tensor) -> bool:
        good = torch.isfinite(value)
        return bool(concrete(good | ~self.failed[..., None, None]).all())

    def _jumps(self, value: Callable[[Tensor], Tensor]) -> bool:
        """Whether `value`, of a share (...) from 0 to 1, jumps in a failed sample: by halves."""
        low = torch.zeros_like(self.problem.start.work)
        high = torch.ones_like(low)
        before, after = value(low), value(high)
        whole, size = self._size(after - before), self._size(before) + self._size(after)
        for _ in range(HALVES):
            middle = (low + high) / 2
            now = value(middle)
            left = self._size(now - before) > self._size(after - now)
            wide = left[..., None, None]
            low, high = torch.where(left, low, middle), torch.where(left, middle, high)
            before, after = torch.where(wide, before, now), torch.where(wide, now, after)
        jump = (self._size(after - before) > whole / 2) & (
            whole > torch.finfo(size.dtype).eps ** 0.5 * size
        )
        return bool(concrete(jump & self.failed).any())

    def _size(self, value: Tensor) -> Tensor:
        """(...) of the samples."""
        return value.expand(*self.failed.shape, *value.shape[-2:]).abs().amax((-1, -2))


class Failures(dict[int, Failure]):
    """The first failure of a stepper by its status; `warned`: those that the user knows of."""

    def __init__(self) -> None:
        super().__init__()
        self.warned: set[int] = set()

    def warn(self) -> None:
        """Warns of each once."""
        for code in self.keys() - self.warned:
            self.warned.add(code)
            failure = self[code]
            failed, t = concrete(failure.failed), concrete(failure.problem.start.t)
            warn(stopped(failed, t, failure.reason() or STATUS[code]))

    def remember(self, method: Method, model: Model, span: Span, status: Tensor) -> None:
        """What a step has failed at for good, where its status (...) is a new one, to be asked for
        a reason; nothing that carries gradient.
        """
        for code in set(concrete(status).flatten().tolist()) - {SUCCESS, *self}:
            t, dt = span.t.detach(), span.dt.detach()
            held = {name: value.detach() for name, value in span.inputs(method.INSTANT).items()}
            start = span.state.detach()
            problem = method.problem(model, start, dt, t + method.INSTANT * dt, held)
            self[code] = Failure(problem, status == code)

    def reasons(self) -> dict[int, str]:
        """Sentences by status, where one is found."""
        return {
            code: reason for code, failed in self.items() if (reason := failed.reason()) is not None
        }


def _level(*parts: Tensor) -> tuple[Tensor, ...]:
    shape = broadcast_shapes(*(x.shape[:-1] for x in parts))
    return tuple(x.expand(*shape, x.shape[-1]) for x in parts)


def _name(effect: Effect) -> str:
    node = effect.node
    where = "" if node is None else " on the tip" if node == -1 else f" on node {node}"
    return effect.called + where
