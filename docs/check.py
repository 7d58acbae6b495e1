"""How the pages read, in numbers: words, sentences, code, tables, equations, figures.

python docs/check.py [--json]        (the status is 1 where a page has what NONE names)
"""

import argparse
import json
import re
import statistics
import sys
import unicodedata
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS))

import equations  # noqa: E402

LONG, MOST = 30, 25
"""A sentence is long above so many words, and has no more than so many."""
ROWS = 6
"""A table of a how-to is long above so many rows."""
HOW_TO = ("tutorials/", "how-to/")
"""Folders whose pages say how to do something."""
ARCHIVE = "archive/"
"""Studies behind the pages: not counted."""
NO_CODE = ("papers/", "theory")
"""Pages that need no code."""
NONE = (
    f"sentences above {MOST} words",
    "sentences of how-tos with more than two numbers",
    f"tables of how-tos above {ROWS} rows",
    "equations of one tag twice",
    "figures without a page",
    "broken links",
    "pages not in the menu, or missing",
)
"""What no page may have."""
ENTRY = re.compile(r"^::: .*\n(?: {4}.*\n?)*", re.MULTILINE)
"""A name of the API with its options, which mkdocstrings replaces."""
FRONT = re.compile(r"\A---\n.*?\n---\n", re.DOTALL)
FENCED = re.compile(r"^```.*?\n(.*?)^```", re.DOTALL | re.MULTILINE)


def pages() -> dict[str, str]:
    """Text of each page by its path below docs/, without front matter."""
    found = sorted(DOCS.rglob("*.md"))
    return {
        page.relative_to(DOCS).as_posix(): FRONT.sub("", page.read_text(encoding="utf-8"))
        for page in found
    }


def read(texts: dict[str, str]) -> dict[str, str]:
    """Pages that are counted: all but the archive."""
    return {name: text for name, text in texts.items() if not name.startswith(ARCHIVE)}


def menu() -> set[str]:
    """Pages that the menu names."""
    text = (DOCS.parent / "mkdocs.yml").read_text(encoding="utf-8").split("\nnav:\n")[1]
    return set(re.findall(r"^ +- (?:[^:\n]+: )?(\S+\.md)$", text, re.MULTILINE))


def words(text: str) -> int:
    """Words outside code and entries of the API."""
    return len(ENTRY.sub("", FENCED.sub("", text)).split())


def read_words(text: str) -> int:
    """Words outside code, a formula as one: blanks in LaTeX are no words."""
    plain = re.sub(r"\$\$.*?\$\$", "X", text, flags=re.DOTALL)
    return words(re.sub(r"\$[^$\n]*\$", "X", plain))


def sentences(text: str) -> list[str]:
    """Sentences of the prose: no code, tables, headings, equations, pictures; items one by one."""
    text = ENTRY.sub("\n\n", FENCED.sub("\n\n", text))
    text = re.sub(r"\$\$.*?\$\$", " formula ", text, flags=re.DOTALL)
    text = re.sub(r"(?<=\n\n)(?: {4}.*\n)+", "\n", text)  # what is printed, indented
    text = re.sub(r"^(?:#|\||!\[|:::|!!!).*$", "\n", text, flags=re.MULTILINE)
    text = re.sub(r"^ *(?:[-*]|\d+\.) ", "\n\n", text, flags=re.MULTILINE)
    text = re.sub(r"\]\([^)]*\)", "", text).replace("[", "")
    text = re.sub(r"\$[^$]*\$|`[^`]*`", "X", text)
    blocks = (" ".join(block.split()) for block in re.split(r"\n\s*\n", text))
    split = (re.split(r"(?<=[.!?])[*_)\"]* (?=[A-Z*_(\"])", block) for block in blocks if block)
    return [sentence for found in split for sentence in found if len(sentence.split()) > 1]


def tables(text: str) -> list[int]:
    """Rows of each table, its head left out."""
    found = re.findall(r"(?:^\|.*\n?)+", FENCED.sub("", text), re.MULTILINE)
    return [table.strip().count("\n") - 1 for table in found]


def figures_without_a_page(texts: dict[str, str]) -> list[str]:
    """Pictures below docs/ that neither a page nor the README shows."""
    shown = set()
    for name, text in {
        **texts,
        "../README.md": (DOCS.parent / "README.md").read_text("utf-8"),
    }.items():
        for target in re.findall(r"\]\(([^)\s#]+\.(?:png|svg))\)|src=\"([^\"]+)\"", text):
            shown.add(((DOCS / name).parent / (target[0] or target[1])).resolve())
    pictures = [path for kind in ("png", "svg") for path in DOCS.rglob(f"*.{kind}")]
    return sorted(path.relative_to(DOCS).as_posix() for path in pictures if path not in shown)


def slug(heading: str) -> str:
    """The anchor that a heading gets."""
    plain = re.sub(r"\]\([^)]*\)|[\[`*]", "", heading)
    plain = unicodedata.normalize("NFKD", plain).encode("ascii", "ignore").decode()
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", plain).strip().lower())


def anchors(text: str) -> set[str]:
    """Anchors of a page: headings, equations, and those that are set by hand."""
    plain = FENCED.sub("", text)
    found = re.findall(r"^#+ (.*?)(?: *\{#([\w-]+)\})?$", plain, re.MULTILINE)
    named = {name or slug(heading) for heading, name in found}
    named |= {f"eq-{tag}" for tag in equations.tags(plain)}
    return named | set(re.findall(r"\bid=\"([^\"]+)\"", plain))


def links(text: str) -> list[str]:
    """Relative targets of links and pictures outside code."""
    plain = re.sub(r"\$\$.*?\$\$|`[^`\n]*`|\$[^$\n]*\$", "X", FENCED.sub("", text), flags=re.DOTALL)
    found = re.findall(r"\]\(<?([^)\s>]+)|(?:src|href)=\"([^\"]+)\"", plain)
    every = [target[0] or target[1] for target in found]
    return [target for target in every if not re.match(r"[a-z]+:|/", target)]


def broken_links(texts: dict[str, str]) -> list[str]:
    """Links to files or anchors that are not there, as "page: target"; README and others too."""
    root, lost = DOCS.parent, []
    outside = {
        f"../{name}.md": (root / f"{name}.md").read_text("utf-8")
        for name in ("README", "CONTRIBUTING", "CHANGELOG")
    }
    for name, text in {**texts, **outside}.items():
        for target in links(text):
            path, _, anchor = target.partition("#")
            place = (DOCS / name).parent / path if path else DOCS / name
            there = place.exists()
            if there and anchor and place.suffix == ".md":
                there = anchor in anchors(place.read_text(encoding="utf-8"))
            if not there:
                lost.append(f"{name}: {target}")
    return lost


def not_in_the_menu(texts: dict[str, str]) -> list[str]:
    """Pages that the menu does not name, and pages that it names and that are not there.

    Pages of the archive are named by the index of the archive instead.
    """
    named, index = menu(), texts.get(f"{ARCHIVE}index.md", "")
    named |= {f"{ARCHIVE}{target.partition('#')[0]}" for target in links(index)}
    return sorted({*texts} - named) + sorted(
        f"{name} (missing)" for name in menu() if name not in texts
    )


def by_folder(texts: dict[str, str]) -> dict[str, int]:
    """Words of the pages of each folder; the folder of the pages at the top is empty."""
    found: dict[str, int] = {}
    for name, text in sorted(texts.items()):
        folder = name.rpartition("/")[0]
        found[folder] = found.get(folder, 0) + words(text)
    return found


def counted() -> dict[str, float]:
    """All numbers by name."""
    every = pages()
    texts = read(every)
    said = [sentence for text in texts.values() for sentence in sentences(text)]
    plain = {name: text for name, text in texts.items() if not name.startswith(NO_CODE)}
    code = "".join(found for text in plain.values() for found in FENCED.findall(text))
    code_lines = sum(bool(line.strip()) for line in code.splitlines())
    guides = {name: text for name, text in texts.items() if name.startswith(HOW_TO)}
    told = [sentence for text in guides.values() for sentence in sentences(text)]
    theory = equations.theory(texts)
    tags = [tag for text in theory.values() for tag in equations.tags(text)]
    drawn = [
        equations.on_page_content(
            re.sub(
                r"\$\$(.*?)\$\$", r'<div class="arithmatex">\\[\1\\]</div>', text, flags=re.DOTALL
            )
        )
        for text in theory.values()
    ]
    anchored = {name for html in drawn for name in re.findall(r'id="eq-([^"]*)"', html)}
    kept = {name: text for name, text in every.items() if name.startswith(ARCHIVE)}
    return {
        "pages": len(texts),
        "words": sum(map(words, texts.values())),
        "words, a formula as one": sum(map(read_words, texts.values())),
        "words of the theory, a formula as one": sum(
            read_words(text) for name, text in texts.items() if name.startswith("theory")
        ),
        "words of the archive": sum(map(words, kept.values())),
        **{f"words of {folder or 'the top'}": found for folder, found in by_folder(every).items()},
        "words of the median page": statistics.median(map(words, texts.values())),
        "words of the README": words((DOCS.parent / "README.md").read_text("utf-8")),
        "lines of code for 100 words": round(
            100 * code_lines / sum(map(words, plain.values())), 2
        ),
        "sentences": len(said),
        f"sentences above {LONG} words [%]": round(
            100 * sum(len(sentence.split()) > LONG for sentence in said) / len(said), 1
        ),
        f"sentences above {MOST} words": sum(len(sentence.split()) > MOST for sentence in said),
        "sentences of how-tos with more than two numbers": sum(
            len(re.findall(r"(?<![\w.])\d[\d.,]*", sentence)) > 2 for sentence in told
        ),
        f"tables of how-tos above {ROWS} rows": sum(
            rows > ROWS for text in guides.values() for rows in tables(text)
        ),
        "equations": len(tags),
        "equations of one tag only": len({*tags}),
        "equations of one tag twice": len(tags) - len({*tags}),
        "equations with an anchor": len(anchored),
        "figures without a page": len(figures_without_a_page(every)),
        "broken links": len(broken_links(every)),
        "pages not in the menu, or missing": len(not_in_the_menu(every)),
    }  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    found = counted()
    faulty = any(found[name] for name in NONE)
    if parser.parse_args().json:
        print(json.dumps(found, indent=1, ensure_ascii=False))
        return faulty
    width = max(map(len, found))
    for name, value in found.items():
        print(f"{name:<{width}}  {value:>7g}")
    every = pages()
    for said, names in {
        "without a page": figures_without_a_page(every),
        "broken link": broken_links(every),
        "not in the menu": not_in_the_menu(every),
    }.items():
        for name in names:
            print(f"{said}: {name}")
    return faulty


if __name__ == "__main__":
    sys.exit(main())
