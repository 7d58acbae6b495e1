"""Options of a script: its docstring as help, and those that most of them share."""

import argparse
from pathlib import Path
from typing import Any

RUNS = Path(__file__).resolve().parent.parent / "runs"


class Options(argparse.ArgumentParser):
    """A parser that says a module's docstring as it stands.

    With `out`, a folder in runs/, it has --out, which is made; with `json`, --json. With
    `defaults` the help names what is taken where nothing is given.
    """

    def __init__(
        self, doc: str | None, out: str = "", *, json: bool = False, defaults: bool = False
    ) -> None:
        formatter = argparse.RawDescriptionHelpFormatter
        super().__init__(
            description=doc,
            formatter_class=argparse.ArgumentDefaultsHelpFormatter if defaults else formatter,
        )
        self._out, self._json = out, json

    def add(self, *names: str, **how: Any) -> None:
        """One more option, as add_argument takes it."""
        self.add_argument(*names, **how)

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """What is given; the shared options stand last in the help."""
        if self._out:
            self.add("--out", type=Path, default=RUNS / self._out, help="for the results")
        if self._json:
            self.add("--json", action="store_true", help="print the numbers as JSON")
        self._json, out, self._out = False, self._out, ""
        given = super().parse_args(args, namespace)
        if out:
            given.out.mkdir(parents=True, exist_ok=True)
        return given
