"""What functions share of their arguments."""

import inspect
import re

import pytest

import torchbeam as tb
from torchbeam.core.docstrings import with_arguments_of, with_entries


@pytest.mark.parametrize("function", [tb.simulate, tb.monte_carlo, tb.converge])
def test_help_tells_of_every_argument(function):
    """Once, be it said with the function or in a record of options."""
    said = function.__doc__.partition("\nArgs:\n")[2].partition("\n\n")[0]
    heads = re.findall(r"^    (\w[\w, ]*):", said, re.M)
    names = [name for head in heads for name in head.split(", ")]
    taken = inspect.signature(function).parameters
    assert sorted(names) == sorted(taken)


def test_entries_stand_behind_those_of_the_function():
    class Options:
        """Of runs.

        Args:
            step: s
        """

    @with_arguments_of(Options)
    def run(t, step):
        """A run.

        Args:
            t: s, of which
                there are many

        Returns:
            Nothing.
        """

    assert run.__doc__ == (
        "A run.\n\nArgs:\n    t: s, of which\n        there are many\n    step: s\n\n"
        "Returns:\n    Nothing."
    )
    assert with_entries("A.\n\nArgs:\n    a: b", "C.\n\nArgs:\n    c: d").endswith("a: b\n    c: d")
