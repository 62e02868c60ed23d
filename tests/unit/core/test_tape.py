"""A tape gives what the function gives that it was made of, or nothing."""

import warnings

import pytest
import torch
from torch.testing import assert_close

from torchbeam.core.remembered import remembered
from torchbeam.core.tape import Recording, current_recording
from torchbeam.core.warning import warn
from torchbeam.math import quaternions

X, Y = torch.tensor([1.0, -2.0, 3.0]), torch.tensor([0.5, 0.25, 2.0])


def recorded(function, *inputs):
    with Recording(inputs) as recording:
        result = function(*inputs)
    return recording.tape([result]), recording.spoilt


def branches(x, y):
    return x / y if (x.sum() > 0) else x * y


def writes(x, y):
    z = torch.zeros_like(x)
    z[:2] = x[:2]
    z[2:].add_(y[2:])
    return z + y


def parts(x, y):
    a, (b, c) = torch.cat((x, y)).unbind()[0], torch.stack([x, y], dim=1).max(0)
    return a + b.sum() + c.double().sum()


def of_the_package(x, y):
    return quaternions.matrix(torch.cat((x, y[:1])))


def nested(x, y):
    return torch.stack([remembered(branches, x, y), remembered(branches, y, y)])


@pytest.mark.parametrize("function", [branches, writes, parts, of_the_package, nested])
def test_a_tape_gives_what_the_function_gives(function):
    """Of other numbers as well, that go the same way; its own inputs are not written to."""
    tape, spoilt = recorded(function, X, Y)
    assert spoilt is None
    for scale in (1.0, 1.5):
        x, y = scale * X, Y / scale
        assert_close(*tape(x, y), function(x, y), rtol=0, atol=0)
        assert torch.equal(x, scale * X)


def test_numbers_that_go_another_way_end_it():
    tape, _ = recorded(branches, X, Y)
    assert tape(-X, Y) is None


def signs(x):
    return 2.0 * x, x[0].item() > 0


def test_what_is_remembered_beside_tensors_ends_it():
    """What is no tensor in it is the same, or there is no result."""

    def function(x, y):
        doubled, positive = remembered(signs, x)
        return doubled + y if positive else doubled - y

    tape, _ = recorded(function, X, Y)
    assert torch.equal(*tape(3 * X, Y), function(3 * X, Y)) and tape(-X, Y) is None


def test_the_same_operation_is_made_once():
    calls = []

    class Counted(torch.overrides.TorchFunctionMode):
        def __torch_function__(self, call, types, args=(), kwargs=None):
            calls.append(call)
            return call(*args, **(kwargs or {}))

    tape, _ = recorded(lambda x, y: (x + 1.0) * y + (x + 1.0).detach(), X, Y)
    with Counted():
        (z,) = tape(X, Y)
    assert len(calls) == 3
    assert_close(z, (X + 1) * Y + X + 1)


@pytest.mark.parametrize(
    ("function", "why"),
    [
        (lambda x, y: x + torch.from_numpy(y.numpy()), "numpy gave ndarray"),
        (lambda x, y, z=Y * 2: x + z, "elsewhere"),
        (lambda x, y: x.add_(y), "not the tape's alone"),
        (lambda x, y: torch.where(x > 0, x + y, x + y).add_(x + y), "not the tape's alone"),
        (lambda x, y: torch.add(x, y, out=torch.empty(3)), "gave Tensor"),
        (lambda x, y: torch.einsum("i,i->i", *iter((x, y))), None),
    ],
)
def test_what_has_no_tape(function, why):
    tape, spoilt = recorded(function, X.clone(), Y.clone())
    assert (tape is None) == (why is not None)
    assert why is None or why in spoilt


def test_a_warning_is_given_each_time():
    def warned(x, y):
        warn("careful")
        return x + y

    with warnings.catch_warnings(record=True):
        tape, spoilt = recorded(warned, X, Y)
    assert tape is None and "warning" in spoilt


def test_an_input_in_two_places_has_no_tape():
    """Others may differ there."""
    tape, _ = recorded(lambda x, y: x + y, X, X)
    assert tape is None


def test_nothing_is_noted_outside():
    assert current_recording() is None
    with Recording([X]) as recording:
        assert current_recording() is recording
        with recording.paused():
            assert current_recording() is None
