"""Tests of refusals by their rows: what is given, and words of the sentence that answers it."""

import functools
import inspect

import pytest


def refusals(*rows):
    """A decorator: what a test does with a row, all but its last entry, is refused in the words of
    that (a regular expression), by a ValueError. rows: so many, or one mapping of these by name.
    """
    named = rows[0] if len(rows) == 1 and isinstance(rows[0], dict) else None
    rows = list(rows if named is None else named.values())

    def of_rows(test):
        taken = [*inspect.signature(test).parameters.values()]
        words = inspect.Parameter("words", inspect.Parameter.POSITIONAL_OR_KEYWORD)

        @functools.wraps(test)
        def refused(words, **given):
            with pytest.raises(ValueError, match=words):
                test(**given)

        refused.__signature__ = inspect.Signature([*taken, words])
        names = [*(parameter.name for parameter in taken[: len(rows[0]) - 1]), "words"]
        return pytest.mark.parametrize(names, rows, ids=None if named is None else list(named))(
            refused
        )

    return of_rows
