"""Options of a script: its docstring as help, and a table of names, defaults and words."""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

RUNS = Path(__file__).resolve().parent.parent / "runs"


class Options(argparse.ArgumentParser):
    """A parser whose help is a module's docstring, as it stands.

    Args:
        doc: the docstring.
        out: a folder in runs/, for --out, which is made.
        json: whether there is --json.
        options: by name, a default and the help. The default of a list is a list; a tuple of words
            is a choice, of which the first is taken; False is a flag; a type in place of a default
            stands for none.
    """

    def __init__(
        self,
        doc: str | None,
        out: str = "",
        *,
        json: bool = False,
        options: Mapping[str, tuple[Any, str]] | None = None,
    ) -> None:
        formatter = argparse.RawDescriptionHelpFormatter
        super().__init__(description=doc, formatter_class=formatter)
        every, self._lists = dict(options or {}), {}
        if out:
            every["out"] = RUNS / out, "folder for the results"
        if json:
            every["json"] = False, "print the numbers as JSON"
        for name, (default, words) in every.items():
            how: dict[str, Any] = {"type": type(default), "default": default}
            if default is False:
                how = {"action": "store_true"}
            elif isinstance(default, type):
                how = {"type": default}
            elif isinstance(default, tuple):
                how = {"choices": default, "default": default[0]}
            elif isinstance(default, list):
                how |= {"type": type(default[0]), "nargs": "+"}
            told = f" (default: {how['default']})" if how.get("default") not in (None, "") else ""
            if isinstance(default, list):  # replaced by what is typed, which adds up
                self._lists[name] = default
                how |= {"action": "extend", "default": argparse.SUPPRESS}
            self.add_argument(
                f"--{name.replace('_', '-')}", **how, help=(words + told).replace("%", "%%")
            )
        self._makes = bool(out)

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """What is given; the folder of results is made."""
        given = super().parse_args(args, namespace)
        vars(given).update(self._lists | vars(given))
        if self._makes:
            given.out.mkdir(parents=True, exist_ok=True)
        return given
