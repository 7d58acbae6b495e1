"""The page of the commands, from their parser.

python docs/commands.py
"""

import argparse
import re
import textwrap
from pathlib import Path

from warp_peri.cli.main import _parser

PAGE = Path(__file__).resolve().parent / "reference" / "commands.md"
HIDDEN = ("help", "config", "json")
"""Options of every command, which the head of the page explains."""
HEAD = """# Commands

Look up every command of `warp-peri`, its options and their defaults. `python docs/commands.py`
makes this page from what `warp-peri COMMAND --help` prints.

```text
warp-peri COMMAND --help
warp-peri COMMAND --config settings.toml
```

Commands that write results keep their settings as such a file next to them. `--json` prints one
object for other programs. The exit status is 0, or 1 after a failure, 2 for input that cannot be
used, and 130 after Ctrl-C.
"""


def page() -> str:
    """Text of the page."""
    parser = _parser()
    (commands,) = (
        action for action in parser._actions if isinstance(action, argparse._SubParsersAction)
    )
    short = {action.dest: action.help or "" for action in commands._choices_actions}
    return HEAD + "".join(_command(name, one, short) for name, one in commands.choices.items())


def _command(name: str, parser: argparse.ArgumentParser, short: dict[str, str]) -> str:
    text = f"\n## {name}\n\n{_plain(parser.description or short.get(name, ''))}\n"
    if parser.epilog:
        text += f"\n```text\n{_examples(parser.epilog % {'prog': parser.prog})}\n```\n"
    for group in parser._action_groups:
        actions = [
            action
            for action in group._group_actions
            if action.help is not argparse.SUPPRESS and action.dest not in HIDDEN
        ]
        if actions:
            title = group.title or ""
            text += f"\n*{title[:1].upper()}{title[1:]}*\n\n" if title else "\n"
            text += "".join(_option(parser, action) for action in actions)
    return text


def _option(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    formatter = parser._get_formatter()
    value = action.metavar or (action.dest if not action.option_strings else action.dest.upper())
    if action.choices is not None and action.metavar is None:
        value = "{" + ",".join(map(str, action.choices)) + "}"
    value = " ".join(value) if isinstance(value, tuple) else str(value)
    if action.nargs in ("+", "*"):
        value += " …"
    elif isinstance(action.nargs, int) and action.nargs > 1 and action.metavar is None:
        value = " ".join([value] * action.nargs)
    words = [*action.option_strings[-1:], *([value] if action.nargs != 0 else [])]
    said = _plain(formatter._expand_help(action)) if action.help else ""
    needed = " (required)" if action.required and action.option_strings else ""
    return f"- `{' '.join(words)}`{needed}" + (f": {said}" if said else "") + "\n"


def _plain(text: str) -> str:
    """Text of one line, or paragraphs, without what Markdown would read as its own."""
    paragraphs = [" ".join(part.split()) for part in text.split("\n\n")]
    return "\n\n".join(paragraphs).replace("<", "&lt;").replace("*", r"\*")


def _examples(text: str) -> str:
    """The lines of an epilog, without the heading over them."""
    lines = [line for line in text.strip().split("\n") if not re.fullmatch(r"\w+:", line.strip())]
    return textwrap.dedent("\n".join(lines))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
