"""The one exception that means: what you gave cannot be used, and why."""

LONGEST = 2000
"""Characters of a message; what a file holds may be repeated in it, and may be long."""


class InputError(ValueError):
    """Bad input. The message says what was expected and what came, in one printable line."""

    def __init__(self, message: object) -> None:
        line = " ".join(str(message)[: 4 * LONGEST].split())
        shown = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)
        super().__init__(shown if len(shown) <= LONGEST else shown[:LONGEST] + " …")
