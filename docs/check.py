"""How the pages read, in numbers: words, sentences, code, tables, equations, figures.

python docs/check.py [--json]
"""

import argparse
import json
import re
import statistics
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS))

import equations  # noqa: E402

LONG = 30
"""A sentence is long above so many words."""
ROWS = 6
"""A table of a how-to is long above so many rows."""
HOW_TO = ("Tutorials", "How-to")
"""Parts of the menu whose pages say how to do something."""
AVOIDED = {
    "law": r"laws?",
    "carry": r"carr(?:y|ies|ied|ying) (?:to|onto|over)|carried",
    "even, uneven": r"(?:an?|the|of) even (?:solid|sheet|one|body)|uneven",
    "beside": r"beside",
    "stands": r"stands?",
    "told, given, held moduli": r"(?:told|given|held) moduli|moduli (?:are )?(?:told|given|held)",
    "home": r"home",
    "turned": r"turned",
    "torn": r"torn",
    "at rest": r"at rest",
    "numbers of a model": r"(?:more|fewer|its|few|two|three|four|six|nine|\d+) numbers",
    "says otherwise": r"says? otherwise",
    "scene": r"scenes?",
    "read out": r"read out",
    "% off": r"% off|off by",
    "corners of cells": r"corners of cells",
    "tells": r"tells?",
    "speaks of": r"speaks? of",
    "say nothing": r"says? nothing",
    "read this if, whoever": r"read this if|whoever|look here",
}
"""What the style of the pages avoids, and how it is found."""
FENCED = re.compile(r"^```.*?\n(.*?)^```", re.DOTALL | re.MULTILINE)


def pages() -> dict[str, str]:
    """Text of each page by its path below docs/."""
    found = sorted(DOCS.rglob("*.md"))
    return {page.relative_to(DOCS).as_posix(): page.read_text(encoding="utf-8") for page in found}


def how_to() -> set[str]:
    """Pages that the menu puts under HOW_TO."""
    menu = (DOCS.parent / "mkdocs.yml").read_text(encoding="utf-8").split("\nnav:\n")[1]
    parts = re.findall(r"^  - ([^:\n]+):\n((?:      - .*\n?)+)", menu, re.MULTILINE)
    return {page for name, of in parts if name in HOW_TO for page in re.findall(r": (\S+\.md)", of)}


def words(text: str) -> int:
    """Words outside code."""
    return len(FENCED.sub("", text).split())


def sentences(text: str) -> list[str]:
    """Sentences of the prose: no code, tables, headings, equations, pictures; items one by one."""
    text = re.sub(r"\$\$.*?\$\$", " formula ", FENCED.sub("\n\n", text), flags=re.DOTALL)
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


def counted() -> dict[str, float]:
    """All numbers by name."""
    texts = pages()
    said = [sentence for text in texts.values() for sentence in sentences(text)]
    plain = {
        name: text for name, text in texts.items() if "papers/" not in name and name != "theory.md"
    }
    code = "".join(found for text in plain.values() for found in FENCED.findall(text))
    code_lines = sum(bool(line.strip()) for line in code.splitlines())
    prose = "\n".join(said)
    guides = {name: texts[name] for name in how_to()}
    told = [sentence for text in guides.values() for sentence in sentences(text)]
    tags = equations.tags(texts["theory.md"])
    drawn = re.sub(
        r"\$\$(.*?)\$\$",
        r'<div class="arithmatex">\\[\1\\]</div>',
        texts["theory.md"],
        flags=re.DOTALL,
    )
    anchors = re.findall(r'id="eq-([^"]*)"', equations.on_page_content(drawn))
    avoided = {
        word: len(re.findall(rf"\b(?:{how})\b" if "%" not in how else how, prose, re.IGNORECASE))
        for word, how in AVOIDED.items()
    }
    return {
        "pages": len(texts),
        "words": sum(map(words, texts.values())),
        "words of the median page": statistics.median(map(words, texts.values())),
        "words of the README": words((DOCS.parent / "README.md").read_text("utf-8")),
        "lines of code for 100 words": round(
            100 * code_lines / sum(map(words, plain.values())), 2
        ),
        "sentences": len(said),
        f"sentences above {LONG} words [%]": round(
            100 * sum(len(sentence.split()) > LONG for sentence in said) / len(said), 1
        ),
        "sentences of how-tos with more than two numbers": sum(
            len(re.findall(r"(?<![\w.])\d[\d.,]*", sentence)) > 2 for sentence in told
        ),
        f"tables of how-tos above {ROWS} rows": sum(
            rows > ROWS for text in guides.values() for rows in tables(text)
        ),
        "equations": len(tags),
        "equations of one tag only": len({*tags}),
        "equations with an anchor": len({*anchors}),
        "words to avoid": sum(avoided.values()),
        **{f"to avoid: {word}": count for word, count in avoided.items()},
        "figures without a page": len(figures_without_a_page(texts)),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    found = counted()
    if parser.parse_args().json:
        print(json.dumps(found, indent=1, ensure_ascii=False))
        return
    width = max(map(len, found))
    for name, value in found.items():
        print(f"{name:<{width}}  {value:>7g}")
    for name in figures_without_a_page(pages()):
        print(f"without a page: {name}")


if __name__ == "__main__":
    main()
