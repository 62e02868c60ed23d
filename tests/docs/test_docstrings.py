"""The example in the docstring of every public name: it is there, runs, and gives what it says."""

import doctest
import inspect
import re
import warnings

import pytest
import torch
import torchbeam_envs
from torchbeam_envs import baselines

import torchbeam as tb
from torchbeam import extend

# The module in whose docstring stands what examples go on from -> those whose names they are of.
MODULES = {
    tb: (tb, tb.sensors, tb.laws, tb.plot),
    extend: (extend,),
    torchbeam_envs: (torchbeam_envs, torchbeam_envs.functional, baselines),
}
# Constants, and what annotates alone, have no docstring: they stand in their modules'.
PUBLIC = {
    f"{module.__name__}.{name}": (value, start)
    for start, modules in MODULES.items()
    for module in modules
    for name in module.__all__
    for value in [getattr(module, name)]
    if (inspect.isclass(value) or inspect.isroutine(value)) and value is not extend.Value
}
EXTRAS = {
    "torchbeam.view": "viser",
    "torchbeam.View": "viser",
    "torchbeam.plot": "matplotlib",
    "torchbeam_envs.Sb3VecEnv": "stable_baselines3",
}
DEFAULT = torch.get_default_dtype()  # in which the tests run
NUMBER = re.compile(r"-?\d+\.?\d*(?:e[+-]?\d+)?")


DOUBLE = re.compile(r",\s+dtype=torch\.(float64|complex128)")  # of mechanics, told by every tensor


class Close(doctest.OutputChecker):
    """Numbers agree within a per cent, as another machine rounds; all else to the letter, but for
    the space between and double precision.
    """

    def check_output(self, want, got, flags):
        def rest(text):
            return NUMBER.sub("#", " ".join(text.split())).replace(" ", "")

        got = DOUBLE.sub("", got)
        a, b = (list(map(float, NUMBER.findall(text))) for text in (want, got))
        return rest(want) == rest(got) and b == pytest.approx(a, rel=1e-2, abs=1e-9)


def run(text, names, name):
    """The examples in a text, in order, with these names; what they have defined. What differs is
    an error.
    """
    test = doctest.DocTestParser().get_doctest(text, names, name, None, 0)
    said = []
    runner = doctest.DocTestRunner(Close(), verbose=False)
    runner.run(test, out=said.append, clear_globs=False)
    assert not said, "".join(said)
    return test.globs


@pytest.fixture(scope="module")
def given():
    """What examples go on from, by module."""
    torch.set_default_dtype(torch.float32)
    names = {}
    for module in MODULES:  # a dataclass asks for the module that it is written in
        names[module] = run(module.__doc__, {"__name__": __name__}, module.__name__)
    return names


@pytest.mark.parametrize("name", PUBLIC)
def test_example(name, given, tmp_path, monkeypatch):
    """In an empty folder. Eagerly: a structure of its own is compiled for a second."""
    for of, package in EXTRAS.items():
        if name.startswith(of):
            pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TORCHBEAM_ENGINE", "eager")
    torch.set_default_dtype(torch.float32)  # PyTorch's own
    value, start = PUBLIC[name]
    text = inspect.getdoc(value)
    assert ">>> " in text, f"the docstring of {name} has no example"
    filters = list(warnings.filters)
    try:
        run(text, dict(given[start]), name)
    finally:
        warnings.filters[:] = filters
        torch.set_default_dtype(DEFAULT)


@pytest.mark.parametrize(
    "text", [">>> 1.5\n1.6\n", ">>> 'a'\n'b'\n", ">>> torch.ones(2)\ntensor([1.])\n", ">>> x\n"]
)
def test_a_wrong_example_fails(text):
    with pytest.raises(AssertionError):
        run(text, {"torch": torch}, "wrong")
