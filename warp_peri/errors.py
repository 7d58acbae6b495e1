"""The one exception that means: what you gave cannot be used, and why."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

Called = TypeVar("Called", bound=Callable[..., Any])

LONGEST = 2000
"""Characters of a message; what a file holds may be repeated in it, and may be long."""


class InputError(ValueError):
    """Bad input. The message says what was expected and what came, in one printable line."""

    def __init__(self, message: object) -> None:
        line = " ".join(str(message)[: 4 * LONGEST].split())
        shown = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)
        super().__init__(shown if len(shown) <= LONGEST else shown[:LONGEST] + " …")


def renamed(**now: str) -> Callable[[Called], Called]:
    """Keywords that a function had, and what stands in their place: one error names the new."""

    def decorate(function: Called) -> Called:
        @functools.wraps(function)
        def call(*arguments: Any, **options: Any) -> Any:
            for name in options:
                if name in now:
                    raise InputError(f"{function.__name__}: {name} is now {now[name]}")
            return function(*arguments, **options)

        return call  # type: ignore[return-value]

    return decorate
