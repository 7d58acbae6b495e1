"""The sources, table by table and figure by figure: what is printed beside what is measured here.

    python examples/studies/papers.py you_2021
    python examples/studies/papers.py you_2021 --section "Figures 2 and 3"
    python examples/studies/papers.py you_2021 --page

Takes what other commands left in runs/ and names those that are missing. What it computes itself is
kept in runs/papers/, so that a run that is stopped goes on. Writes docs/archive/papers_NAME.md with
every table; with --section only those whose titles begin so. Its foot says which commit made what.
Then writes docs/papers/NAME.md, the page of claims, whose numbers are read from the long one; with
--page nothing but that, in seconds.
"""

import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from string import Formatter
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

from examples.prose import NUMBER, cells_of, readable
from examples.studies import paper_jafarzadeh_2024, paper_polymer_gp, paper_slides, paper_you_2021
from tools.options import Options
from warp_peri import InputError
from warp_peri.errors import exit_status
from warp_peri.files.atomic import plain, write_json, write_text

SOURCES = {
    "you_2021": paper_you_2021,
    "jafarzadeh_2024": paper_jafarzadeh_2024,
    "polymer_gp": paper_polymer_gp,
    "slides": paper_slides,
}
"""Each has `parts(runs, kept, figures)`: by name, what its template, beside it, leaves open, as
text or a function that gives it; and NEEDED: results that it reads, by the command that makes
them. May have `redraw(page, figures)`: pictures of the rows of its long page."""
CELL = re.compile(r"\{([^{}>]+) > ([^{}>]+) > (\d+)(?: > (\.\d\w)(%?))?\}")
"""A number of a long page, in the template of a short one: section, row, which, digits, in %."""
MADE = re.compile(r"^\*Made at (?P<where>.+?)(?:: (?P<titles>.+))?\.\*$", re.MULTILINE)
"""A line of the foot of a page; without titles it speaks of all sections that no other names."""

Parts = Mapping[str, str | Callable[[], str]]


def sections(text: str) -> dict[str, str]:
    """Sections of a page by title, what stands above them under "", its foot left out."""
    head, *others = re.split(r"^## ", text.split("\n*Made at")[0], flags=re.MULTILINE)
    return {"": head} | {part.split("\n", 1)[0]: f"## {part}" for part in others}


def filled(template: str, parts: Parts) -> str:
    """A template with the parts that it names, computed now."""
    texts = {}
    for name in sorted({name for _, name, _, _ in Formatter().parse(template) if name}):
        part = parts[name]
        texts[name] = part if isinstance(part, str) else part()
    return template.format(**texts)


def foot_of(page: str) -> dict[str, list[str]]:
    """Titles by commit and machine, in the order of the lines."""
    return {
        line["where"]: line["titles"].split("; ") if line["titles"] else []
        for line in MADE.finditer(page)
    }


def remade(page: str, template: str, again: Collection[str], parts: Parts, where: str) -> str:
    """The page with these sections, and those that it lacks, made now."""
    old, foot = sections(page), foot_of(page)
    texts, now = [], []
    for title, text in sections(template).items():
        if title in again or title not in old:
            now.append(title)
            texts.append(filled(text, parts))
        else:
            texts.append(old[title])
            now += [title] * (title in foot.get(where, []))
    made = {}
    for commit, titles in foot.items():
        left = [title for title in titles if title not in now]
        if left or not titles:
            made[commit] = left
    if made.get(where) != []:
        made[where] = now
    return whole(texts, made)


def whole(texts: Collection[str], made: Mapping[str, Collection[str]]) -> str:
    """A page of sections and its foot."""
    foot = (
        f"*Made at {w}{': ' if titles else ''}{'; '.join(titles)}.*" for w, titles in made.items()
    )
    return "\n\n".join([*(text.rstrip() for text in texts), *foot]) + "\n"


def short(template: str, page: str) -> str:
    """A page of claims, with the numbers of the long page."""

    def number(found: re.Match[str]) -> str:
        section, start, which, digits, hundred = found.groups()
        (row, *_) = cells_of(page, section, f"| {start} |")
        numbers = NUMBER.findall(" ".join(row))
        if int(which) >= len(numbers):
            raise ValueError(f"{found[0]}: expected a number of the row, it has {numbers}")
        told = numbers[int(which)]
        return readable(f"{(100 if hundred else 1) * float(told):{digits}}" if digits else told)

    return CELL.sub(number, template)


def keeper(folder: Path) -> Callable[..., Any]:
    """A function that computes a result once and keeps it as JSON in the folder."""

    def kept(name: str, compute: Callable[[], Any]) -> Any:
        path = folder / f"{name}.json"
        if not path.exists():
            write_json(path, plain(compute()))
        return json.loads(path.read_text(encoding="utf-8"))

    return kept


def where() -> str:
    """Commit, dirty if anything but the pages differs from it, and machine."""

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True).stdout

    commit = git("describe", "--always").strip() or "unknown"
    dirty = "-dirty" if git("diff", "--stat", "HEAD", "--", ".", ":!docs") else ""
    return f"commit {commit}{dirty}, {platform.machine()}, {os.cpu_count()} cores"


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__)
    parser.add("source", choices=SOURCES)
    parser.add("--section", nargs="+", default=[], metavar="TITLE", help="only these")
    parser.add("--page", action="store_true", help="the page of claims alone")
    parser.add("--runs", type=Path, default=ROOT / "runs", help="results of the commands")
    parser.add("--out", type=Path, default=ROOT / "docs", help="default: docs/")
    given = parser.parse_args(arguments)
    path, figures = given.out / "archive" / f"papers_{given.source}.md", given.out / "papers"
    source, claims = SOURCES[given.source], figures / f"{given.source}.md"
    for folder in (path.parent, figures):
        folder.mkdir(parents=True, exist_ok=True)
    if not given.page:
        write_text(path, long(given, path, figures))
    page = path.read_text(encoding="utf-8")
    if hasattr(source, "redraw"):
        source.redraw(page, figures)
    template = source.TEMPLATE.with_stem(f"{source.TEMPLATE.stem}_claims")
    write_text(claims, short(template.read_text(encoding="utf-8"), page))
    print(path, claims, sep="\n")
    return 0


def long(given: Any, path: Path, figures: Path) -> str:
    """The page with every table, or with some sections made again."""
    source = SOURCES[given.source]
    template, now = source.TEMPLATE.read_text(encoding="utf-8"), where()
    titles = list(sections(template))[1:]
    again = [title for title in titles if title.startswith(tuple(given.section))]
    missing = [
        f"{command} (it writes {file})"
        for file, command in source.NEEDED.items()
        if not given.section and not (given.runs.parent / file).exists()
    ]
    if missing:
        raise InputError("to be run first: " + "; ".join(missing))
    if given.section and not (again and path.exists()):
        raise InputError(f"section: expected one of those of {path}, got {given.section}")
    parts = source.parts(given.runs, keeper(given.runs / "papers" / given.source), figures)
    if given.section:
        return remade(path.read_text(encoding="utf-8"), template, again, parts, now)
    return whole([filled(template, parts)], {now: []})


if __name__ == "__main__":
    sys.exit(exit_status(main))
