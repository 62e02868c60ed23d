"""Every argument of every public call is given what it cannot be: it is refused in one sentence, or
it is one of its values.

A call that is not in the table `public_calls`, or an argument that the table does not give, fails
the last test.
"""

import inspect
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import torchbeam as tb
from tests.cases.public_calls import BEAM, CALLS, FORCE, OTHER, SCENE, SECTION, START

T = [0.0, 0.1]
WRONG = {
    "an object": object(), "a text": "x", "None in a list": [None],
    "a namespace": SimpleNamespace(t=1.0), "a function of nothing": lambda: None,
    "complex numbers": torch.ones(3) * 1j, "rows of two lengths": [[1.0], [1.0, 2.0]],
}  # fmt: skip
# fmt: off
RAW = {  # what torch, NumPy and Python answer in words of their own
    "a tensor without numbers": torch.ones(3, device="meta"),
    "one number that is none": torch.ones((), device="meta"),
    "a sparse tensor": torch.ones(3).to_sparse(),
    "more than a double": 10**400, "more in a list": [10**400, 0, 0],
    "more than is printed": 10**5000,
    "an array of words": np.array(["midpoint", "x"]), "a word in an array": np.array("midpoint"),
    "half precision": torch.ones(3, dtype=torch.float16),
    "no numbers": torch.ones(0), "no vectors": torch.ones(0, 3),
    "a letter that no name has": "a\0b", "a folder": ".", "nobody's home": "~nobody-here/x",
}
MORE = {
    "None": None, "True": True, "nan": math.nan, "inf": math.inf, "-1": -1, "0": 0, "1.5": 1.5,
    "1e-300": 1e-300,
    "a billion": 10**9, "nothing": [], "no entries": (), "no names": {},
    "single precision": torch.ones(3, dtype=torch.float32),
    "five": torch.ones(5), "booleans": torch.tensor([True, False, True]),
    "nan in a tensor": torch.full((3,), math.nan),
    "a number as a tensor": torch.tensor(1.0), "a section": SECTION, "a beam": BEAM,
    "a scene": SCENE, "a state": START,
    "a state of another beam": tb.rest(OTHER), "a function of anything": lambda *a, **k: None,
    "a function that gives a text":
    lambda *a: "x",
    "a state of nan": START.map(lambda x: torch.full_like(x,
        math.nan) if x.is_floating_point() else x),
}
# fmt: on
# what is asked for, honest work of hours: samples in constant memory, trials one after the other,
# steps of an interval, readings on their way
ENDLESS = {
    ("KalmanFilter", "delay"),
    ("KalmanFilter", "steps"),
    ("KalmanFilter2", "delay"),
    ("KalmanFilter2", "steps"),
    ("MovingHorizon", "delay"),
    ("MovingHorizon", "steps"),
    ("filter.start", "batch"),
    ("advise", "repeats"),
    ("moment_derivatives", "n"),
    ("monte_carlo_stream", "n"),
    ("sobol_indices", "n"),
}
WORDS = "given", "holds", "wanted", "asked for", "meets", "failed", "would", "gave"
OF_MATPLOTLIB = {("plot.shape", "color"), ("plot.shape", "label"), ("plot.history", "label")}
# of RuntimeErrors that a call's docstring names: what it asks for is not there
SENTENCE = "no equilibrium", "failed", "stopped after"


def arguments(function, given):
    """Names that it takes, beside those of the scene's inputs."""
    kinds = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY
    return dict.fromkeys(
        [
            *given,
            *(p.name for p in inspect.signature(function).parameters.values() if p.kind in kinds),
        ]
    )


def answers(call, wrong):
    """What is wrong with the answers to a call whose arguments are these, one after the other."""
    function, given = CALLS[call]
    for name in arguments(function, given):
        for what, value in wrong.items():
            if (call, name) in OF_MATPLOTLIB:
                continue
            if what == "a billion" and (call, name) in ENDLESS:
                continue
            try:
                function(**{**given, name: value})
            except (ValueError, MemoryError, IndexError) as refusal:
                sentence = str(refusal)
                said = any(word in sentence for word in WORDS)
                if "\n" in sentence or len(sentence) > 400 or not said:
                    yield f"{name} = {what}: {sentence!r} is no sentence"
            except Exception as error:
                if not (
                    isinstance(error, RuntimeError)
                    and any(words in str(error) for words in SENTENCE)
                ):
                    yield (
                        f"{name} = {what}: {type(error).__name__}: "
                        f"{str(error).splitlines()[0][:100]}"
                    )


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("call", CALLS)
def test_what_an_argument_cannot_be_is_refused(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # folders of results may have any name
    function, given = CALLS[call]
    function(**given)  # the call as such is a good one
    assert not (found := [*answers(call, WRONG)]), "\n".join(found)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("call", CALLS)
def test_what_is_no_dense_number_is_refused(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert not (found := [*answers(call, RAW)]), "\n".join(found)
    assert not list(tmp_path.glob("~*"))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("call", CALLS)
def test_a_guess_by_place_is_refused_in_a_sentence(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for guess in ((), (3,), (3, FORCE), (FORCE,), (FORCE, FORCE), (SCENE, 4), (SCENE, T, 0.1)):
        try:
            CALLS[call][0](*guess)
        except (ValueError, TypeError, IndexError) as refusal:
            assert "\n" not in str(refusal) and len(str(refusal)) < 400, f"{guess}: {refusal}"


def of_no_sample(value):
    """A scene, state or solution with the batch axis (0,); None for what is none of these."""
    if isinstance(value, tb.Scene):
        every = [*value.effects, tb.Gravity(torch.ones(0, 3))]
        return replace(value, effects=every)
    if isinstance(value, tb.Solution):
        return tb.simulate(of_no_sample(SCENE), [0.0, 0.1, 0.2], step=0.1)
    return value[None][:0] if isinstance(value, tb.State) else None


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("call", CALLS)
def test_a_batch_without_a_sample(call, tmp_path, monkeypatch):
    """It is answered, with as many, or refused in a sentence."""
    monkeypatch.chdir(tmp_path)
    function, given = CALLS[call]
    for name, value in given.items():
        if (empty := of_no_sample(value)) is not None:
            try:
                repr(function(**{**given, name: empty}))
            except ValueError as refusal:
                assert "\n" not in str(refusal), f"{name}: {refusal}"


def test_a_batch_without_a_sample_that_may_touch_itself():
    contact = tb.SelfContact(radius=0.01, thickness=1e-3, force=1.0)
    scene = of_no_sample(tb.Scene(BEAM, [contact]))
    solution = tb.simulate(scene, [0.0, 0.1], step=0.1, engine="eager")
    assert solution.nodes.shape == (2, 0, *BEAM.nodes.shape[-2:])


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("call", CALLS)
def test_what_an_argument_may_not_be_is_refused(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert not (found := [*answers(call, MORE)]), "\n".join(found)


# made by calls
RESULTS = """Advice BlockRate Campbell Comparison Convergence Critical CrossSection Description
Design Energy Estimate FieldFit Filtered Fit Linear MixedState Modes MomentDerivatives PairedModes
Path Pose RareEvent Samples Sensor SlowPathWarning SobolIndices Solution State Stats Stream
Tornado"""
# or without arguments; a view serves a page, see tests/unit/plot/test_view.py
ELSEWHERE = {"Beam", "RootForce", "RootMoment", "RootReaction", "TipVelocity", "identify_fields"}
ELSEWHERE |= {"view", "View"}


def test_every_public_call_is_in_the_table():
    public = {name: getattr(where, name) for where in (tb, tb.sensors) for name in where.__all__}
    called = {getattr(function, "__func__", function) for function, _ in CALLS.values()}
    called |= {type(function) for function, _ in CALLS.values()}
    missing = {name for name, one in public.items() if callable(one) and one not in called}
    assert missing <= {*RESULTS.split(), *ELSEWHERE}
