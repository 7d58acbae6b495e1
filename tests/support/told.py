"""What is said to a user, in words: that something is refused, or a warning."""

import pytest

from warp_peri import InputError

refused = lambda words: pytest.raises(InputError, match=words)
"""That what is asked inside is refused in these words, a pattern."""
warned = lambda words: pytest.warns(UserWarning, match=words)
"""That what is done inside warns in these words, a pattern."""


def each_refused(call, table):
    """What is given, several in a tuple, is refused in the words that it has here."""
    for words, given in table.items():
        all_refused(call, words, [given])


def all_refused(call, words, values):
    """Each of what is given, several in a tuple, is refused in the same words."""
    for given in values:
        with refused(words):
            call(*given) if isinstance(given, tuple) else call(given)


def assert_refused(table):
    """Each call, or each of several, is refused in the words that it has here."""
    for words, calls in table.items():
        for call in calls if isinstance(calls, tuple) else (calls,):
            with refused(words):
                call()
