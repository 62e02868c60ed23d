"""The example in the docstring of every public name: it is there, runs, and gives what it says."""

import doctest
import inspect
import re
import warnings

import pytest
import torch

import torchbeam as tb

PUBLIC = {
    f"{module.__name__}.{name}": getattr(module, name)
    for module in (tb, tb.sensors, tb.laws, tb.plot)
    for name in module.__all__
    if not inspect.ismodule(getattr(module, name))
}
EXTRAS = {"torchbeam.view": "viser", "torchbeam.View": "viser", "torchbeam.plot": "matplotlib"}
NUMBER = re.compile(r"-?\d+\.?\d*(?:e[+-]?\d+)?")


class Close(doctest.OutputChecker):
    """Numbers agree within a per cent, as another machine rounds; all else to the letter, but for
    the space between.
    """

    def check_output(self, want, got, flags):
        def rest(text):
            return NUMBER.sub("#", " ".join(text.split())).replace(" ", "")

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
    """What examples go on from: it stands in the docstring of the package."""
    return run(tb.__doc__, {}, "torchbeam")


@pytest.mark.parametrize("name", PUBLIC)
def test_example(name, given, tmp_path, monkeypatch):
    """In an empty folder. Eagerly: a structure of its own is compiled for a second."""
    for of, package in EXTRAS.items():
        if name.startswith(of):
            pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TORCHBEAM_ENGINE", "eager")
    text = inspect.getdoc(PUBLIC[name])
    assert ">>> " in text, f"the docstring of {name} has no example"
    filters = list(warnings.filters)
    try:
        run(text, dict(given), name)
    finally:
        warnings.filters[:] = filters
        torch.set_default_dtype(torch.float64)


@pytest.mark.parametrize(
    "text", [">>> 1.5\n1.6\n", ">>> 'a'\n'b'\n", ">>> torch.ones(2)\ntensor([1.])\n", ">>> x\n"]
)
def test_a_wrong_example_fails(text):
    with pytest.raises(AssertionError):
        run(text, {"torch": torch}, "wrong")
