"""The one exception that means: what you gave cannot be used, and why."""


class InputError(ValueError):
    """Bad input. The message says what was expected and what came."""
