"""What may be a number, a tensor, a function of t or an `Input`: a batch of it is one answer, in
whichever form it is given and whatever is asked, and that of each number by itself.

References are runs of one sample by plain tensors; forms that a value does not take are refused
when its object is made. Rounding alone is between them: 1e-9 of the largest number.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import pytest
import torch

import torchbeam as tb
from cases.rows import ENDS, JOINTS, ROWS, SECTION, joined

DOUBLE = dict(dtype=torch.float64)
PUSH = tb.TipLoad(force=(0.2, 0.3, 0.4))
T = (0.0, 0.02, 0.04)


def beam(**options) -> tb.Beam:
    return tb.Beam.straight(0.6, 2, SECTION, **options)


def alone(*effects, **options) -> tb.Scene:
    return tb.Scene(beam(), [PUSH, *effects], **options)


FLOOR = dict(thickness=0.05, force=1.0)


@dataclass(frozen=True)
class Value:
    """made: of the value a scene; numbers: two of it; function, given: whether it may be a function
    of t, and an Input.
    """

    made: Callable
    numbers: tuple
    function: bool = True
    given: bool = True


def vector(made, **more) -> Value:
    return Value(made, ((0.1, -0.2, 0.3), (-0.05, 0.1, 0.2)), **more)


MOTION = dict(given=False)
# fmt: off
VALUES = {
    **{name: Value(lambda x, row=row: alone(row.make(x, 2)), row.numbers, "function" in row.forms,
        "input" in row.forms) for name, row in ROWS.items() if row.numbers},
    **{name: Value(lambda x, row=row: joined(row.make(x, *ENDS), push=0.1), row.numbers)
       for name, row in JOINTS.items() if row.numbers},
    "support's place": vector(lambda x: alone(supports=[tb.Support(0),
        tb.Support(-1, displacement=x, rotation="")]), **MOTION),
    "clamp's turn": vector(lambda x: alone(root=tb.RootMotion(rotation=x)), **MOTION),
    "frame's velocity": vector(lambda x: alone(frame=tb.Frame(velocity=x)), **MOTION),
    "frame's spin": vector(lambda x: alone(frame=tb.Frame(angular_velocity=x)), **MOTION),
    "plane's place": Value(lambda x: alone(tb.Contact(tb.Plane(x, (0, 0, 1.0)), **FLOOR)),
        ((0.0, 0.0, -0.01), (0.0, 0.0, -0.02)), given=False),
    "sphere's centre": Value(lambda x: alone(tb.Contact(tb.Sphere(x, 0.1), **FLOOR)),
        ((0.3, 0.0, -0.11), (0.35, 0.0, -0.12)), given=False),
}
# fmt: on


def tensor(x) -> torch.Tensor:
    return torch.tensor(x, **DOUBLE)


def functional(x) -> Callable:
    return lambda t: tensor(x) + 0 * t


def forms(value: Value) -> list[str]:
    more = ("function", value.function), ("input", value.given)
    return ["tensor", *(name for name, there in more if there)]


def asked(value: Value, form: str, x) -> tuple[tb.Scene, dict]:
    """A scene with x in that form, and its inputs."""
    if form != "input":
        return value.made({"tensor": tensor, "function": functional}[form](x)), {}
    given = tensor(x)
    one = isinstance(value.numbers[0], float)
    size = 1 if one else len(value.numbers[0])
    return value.made(tb.Input("x", size)), {"x": given[..., None] if one else given}


def simulated(scene, inputs, engine):
    return tb.simulate(scene, T, step=0.02, inputs=inputs, engine=engine).state[-1].position


CALLS = {
    "eager": lambda scene, inputs: simulated(scene, inputs, "eager"),
    "native": lambda scene, inputs: simulated(scene, inputs, "compiled"),
    "equilibrium": lambda scene, inputs: (
        tb.equilibrium(scene, inputs=inputs, engine="eager").position
    ),
    "compiled equilibrium": lambda scene, inputs: (
        tb.equilibrium(scene, inputs=inputs, engine="compiled").position
    ),
    "path": lambda scene, inputs: tb.path(scene, 0.3, step=0.3, inputs=inputs).state[-1].position,
    "modes": lambda scene, inputs: tb.modes(scene, count=2, inputs=inputs).frequency,
    "linearize": lambda scene, inputs: invariants(tb.linearize(scene, inputs=inputs).A),
    "rollout": lambda scene, inputs: rolled(scene, inputs),
}


def rolled(scene, inputs):
    stepper = tb.Stepper(scene, 0.02, engine="eager")
    shape = torch.broadcast_shapes(scene.batch_shape, *(x.shape[:-1] for x in inputs.values()))
    return tb.rollout(stepper, stepper.rest(shape), 2, inputs=inputs).position[-1]


def invariants(A):
    """(..., 2): coordinates of structures are any that joints allow."""
    return torch.stack([x.diagonal(dim1=-2, dim2=-1).sum(-1) for x in (A @ A, A @ A @ A @ A)], -1)


# One of each kind: native code is made of these, a second for each form, in steps or in statics.
STEPS = ("TipLoad.force", "Tendon.tension", "Hinge.torque", "clamp's turn")
STATICS = ("LineLoad.force", "Actuation.curvature", "Tendon.length")
SAMPLE = STEPS + STATICS
assert {*SAMPLE} <= {*VALUES}
DEAR = {"native": STEPS, "compiled equilibrium": STATICS, "path": STATICS} | dict.fromkeys(
    ("modes", "linearize", "rollout"), SAMPLE
)
# Whose numbers by themselves are the eager ones, to which native code is held by other nets
EAGER = {"native": "eager", "compiled equilibrium": "equilibrium"}


def rows():
    """The rest of the dear ones, and of tensors what other nets have, are long."""
    for name, value in VALUES.items():
        for call in CALLS:
            for form in forms(value):
                # a coordinate that is an Input acts by its acceleration: `linearize` refuses it
                if (name, call, form) in COORDINATES:
                    continue
                long = name not in DEAR[call] if call in DEAR else form == "tensor"
                long &= call not in ("eager", "equilibrium")
                yield pytest.param(name, form, call, marks=[pytest.mark.long] * long)


COORDINATES = {
    (name, "linearize", "input") for name in ("Hinge.angle", "Slider.travel", "Cylindrical.travel")
}


@cache
def reference(name: str, call: str) -> torch.Tensor:
    """Of each number by itself."""
    value = VALUES[name]
    return torch.stack([CALLS[call](*asked(value, "tensor", x)) for x in value.numbers])


@pytest.mark.parametrize("name, form, call", rows())
def test_a_batch_is_each_number_by_itself(name, form, call):
    value = VALUES[name]
    wanted = reference(name, EAGER.get(call, call))
    answer = CALLS[call](*asked(value, form, value.numbers))
    if form == "function" and answer.shape != wanted.shape:  # what is read of t alone may be shared
        answer = answer.expand(wanted.shape)
    assert answer.shape == wanted.shape
    assert (answer - wanted).abs().max() <= 1e-9 * wanted.abs().max()


INSTANTS = torch.linspace(0, 0.06, 10, **DOUBLE)
TAPERED = tb.Table((0.0, 1.0), (0.3, 0.2))
MORE = {
    "LineLoad.force, follower": vector(lambda x: alone(tb.LineLoad(force=x, follower=True))),
    "PointLoad.moment, follower": vector(lambda x: alone(tb.PointLoad(1, moment=x, follower=True))),
    "PointLoad.force, off its node": vector(
        lambda x: alone(tb.PointLoad(1, force=x, offset=(0.0, 0.1, 0.0)))
    ),
    "Drag.flow, sheared": vector(
        lambda x: alone(tb.Drag(1000.0, 0.1, flow=tb.Wind(x, exponent=0.2, height=2.0)))
    ),
    "StripAir.wind, tapered": vector(lambda x: alone(tb.StripAir(TAPERED, density=50.0, wind=x))),
    "StripAir.wind, a sum": vector(
        lambda x: alone(tb.StripAir(TAPERED, density=50.0, wind=tb.Wind(x) + tb.Wind((0, -1.0, 0))))
    ),
    "clamp's place": vector(lambda x: alone(root=tb.RootMotion(displacement=x))),
}
VARYING = {name: value for name, value in (VALUES | MORE).items() if value.function}
RECORDS = {"history": tb.History, "smooth": lambda t, x: tb.SmoothHistory(t, x, 1e-6)}


def varying():
    """Of three components a `History`; a `SmoothHistory` of these is long."""
    for name, value in VARYING.items():
        three = not isinstance(value.numbers[0], float)
        for record in ("history", "smooth") if three else ("smooth",):
            for engine in ("eager", "compiled"):
                long = three and record == "smooth"
                yield pytest.param(name, record, engine, marks=[pytest.mark.long] * long)


@cache
def varied(name: str) -> torch.Tensor:
    """By a plain function of t that goes from the first number to the second, eagerly."""
    first, last = map(tensor, VARYING[name].numbers)
    return moved(name, lambda t: first + t / 0.06 * (last - first), "eager")


@cache
def held(name: str) -> torch.Tensor:
    first = tensor(VARYING[name].numbers[0])
    return moved(name, lambda t: first + 0 * t, "eager")


def moved(name: str, function: Callable, engine: str) -> torch.Tensor:
    solution = tb.simulate(VARYING[name].made(function), (*T, 0.06), step=0.02, engine=engine)
    assert solution.status == 0
    return solution.state[-1].position


@pytest.mark.filterwarnings("ignore:a SmoothHistory whose accelerations")
@pytest.mark.parametrize("name, record, engine", list(varying()))
def test_a_record_goes_on_as_its_function_does(name, record, engine):
    """What follows a line in time, as a plain function and as a record of it (a tree of tensors),
    to 1e-9 of what its change moves: a record that is asked once, and held, moves nothing.
    """
    first, last = (torch.atleast_1d(tensor(x)) for x in VARYING[name].numbers)
    values = first + INSTANTS[:, None] / 0.06 * (last - first)
    answer, wanted = moved(name, RECORDS[record](INSTANTS, values), engine), varied(name)
    change = (wanted - held(name)).abs().max()
    assert change > 1e-7
    assert (answer - wanted).abs().max() <= 1e-9 * change + 1e-14


@pytest.mark.parametrize("name", [name for name, value in VALUES.items() if len(forms(value)) < 3])
def test_other_forms_are_refused(name):
    value = VALUES[name]
    for form in {"function", "input"} - {*forms(value)}:
        with pytest.raises(ValueError, match=r"wanted"):
            asked(value, form, value.numbers[0])
