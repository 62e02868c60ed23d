"""Tests of refusals by their rows: what is given, and words of the sentence that answers it."""

import functools
import inspect
import re

import pytest


def refusals(*rows):
    """A decorator: what a test does with a row, all but its last entry, is refused in the words of
    that (a regular expression), by a ValueError. rows: so many, or one mapping of these by name.
    A test that prepares something has a `yield` behind it: what comes before must not be refused.
    """
    named = rows[0] if len(rows) == 1 and isinstance(rows[0], dict) else None
    rows = list(rows if named is None else named.values())
    either = [words for row in rows for words in row[-1].split("|")]
    vague = [words for words in either if not re.search("[ =]", words)]
    assert not vague, f"words that another refusal may have as well: {vague}"

    def of_rows(test):
        taken = [*inspect.signature(test).parameters.values()]
        words = inspect.Parameter("words", inspect.Parameter.POSITIONAL_OR_KEYWORD)

        @functools.wraps(test)
        def refused(words, **given):
            do = functools.partial(test, **given)
            if inspect.isgeneratorfunction(test):
                do = functools.partial(next, prepared := do(), None)
                next(prepared)
            with pytest.raises(ValueError, match=words):
                do()

        refused.__signature__ = inspect.Signature([*taken, words])
        names = [*(parameter.name for parameter in taken[: len(rows[0]) - 1]), "words"]
        return pytest.mark.parametrize(names, rows, ids=None if named is None else list(named))(
            refused
        )

    return of_rows
