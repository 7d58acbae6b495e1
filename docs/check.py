"""How the pages read: words, sentences, tables, links; 1 where one breaks a rule of STYLE.

python docs/check.py
"""

import re
import sys
import unicodedata
from pathlib import Path

DOCS = Path(__file__).resolve().parent
MOST, ROWS = 25, 6
"""Most words of a sentence, and rows of a table in a guide."""
GUIDES = ("tutorials/", "how-to/")
ENTRY = re.compile(r"^::: .*\n(?: {4}.*\n?)*", re.MULTILINE)
"""A name of the API with its options, which mkdocstrings replaces."""
FENCED = re.compile(r"^```.*?\n(.*?)^```", re.DOTALL | re.MULTILINE)
TAGGED = re.compile(r"\\tag\{([^}]*)\}")


def pages() -> dict[str, str]:
    """Text of each page by its path below docs/, without front matter."""
    front = re.compile(r"\A---\n.*?\n---\n", re.DOTALL)
    return {
        page.relative_to(DOCS).as_posix(): front.sub("", page.read_text(encoding="utf-8"))
        for page in sorted(DOCS.rglob("*.md"))
    }


def menu() -> set[str]:
    """Pages that the menu names."""
    text = (DOCS.parent / "mkdocs.yml").read_text(encoding="utf-8").split("\nnav:\n")[1]
    return set(re.findall(r"^ +- (?:[^:\n]+: )?(\S+\.md)$", text, re.MULTILINE))


def sentences(text: str) -> list[str]:
    """Sentences of the prose: no code, tables, headings, equations, pictures; items one by one."""
    text = ENTRY.sub("\n\n", FENCED.sub("\n\n", text))
    text = re.sub(r"\$\$.*?\$\$", " formula ", text, flags=re.DOTALL)
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


def anchors(text: str) -> set[str]:
    """Anchors of a page: headings, equations, and those that are set by hand."""
    plain, named = FENCED.sub("", text), set()
    for heading, name in re.findall(r"^#+ (.*?)(?: *\{#([\w-]+)\})?$", plain, re.MULTILINE):
        bare = unicodedata.normalize("NFKD", re.sub(r"\]\([^)]*\)|[\[`*]", "", heading))
        slug = re.sub(r"[^\w\s-]", "", bare.encode("ascii", "ignore").decode()).strip().lower()
        named.add(name or re.sub(r"[-\s]+", "-", slug))
    return named | {f"eq-{tag}" for tag in TAGGED.findall(plain)}


def links(text: str) -> list[str]:
    """Relative targets of links and pictures outside code."""
    plain = re.sub(r"\$\$.*?\$\$|`[^`\n]*`|\$[^$\n]*\$", "X", FENCED.sub("", text), flags=re.DOTALL)
    found = re.findall(r"\]\(<?([^)\s>]+)|(?:src|href)=\"([^\"]+)\"", plain)
    every = [target[0] or target[1] for target in found]
    return [target for target in every if not re.match(r"[a-z]+:|/", target)]


def cited() -> set[str]:
    """Equations that pages and docstrings name after a link to the theory or after "theory, "."""
    tag, found = r"(?:[A-Z][A-Za-z]?)?\d+[a-z]?", set()
    several = rf"\(?{tag}(?:(?:, |–| to | and ){tag})*(?!\w)"
    after = re.compile(rf"theory(?:/\w+)?(?:\.md[^),]*)?\)?,(?: equations)? ({several})")
    tops = ("warp_peri", "kernels", "tools", "tests")
    code = [path for top in tops for path in (DOCS.parent / top).rglob("*.py")]
    for path in (*code, *DOCS.rglob("*.md"), DOCS.parent / "README.md"):
        text = " ".join(path.read_text(encoding="utf-8").split())
        found |= {one for some in after.findall(text) for one in re.findall(tag, some)}
    return found


def faults() -> list[str]:
    """What breaks a rule, a line each."""
    texts, shown, lost, numbers = pages(), set(), [], []
    tops = ("README", "CONTRIBUTING", "CHANGELOG")
    outside = {f"../{name}.md": (DOCS.parent / f"{name}.md").read_text("utf-8") for name in tops}
    for name, text in {**texts, **outside}.items():
        for target in links(text):
            path, _, anchor = target.partition("#")
            place = ((DOCS / name).parent / path if path else DOCS / name).resolve()
            shown.add(place)
            there = place.exists()
            if there and anchor and place.suffix == ".md":
                there = anchor in anchors(place.read_text(encoding="utf-8"))
            lost += [] if there else [f"{name}: broken link {target}"]
    for name, text in texts.items():
        guide, numbers = name.startswith(GUIDES), numbers + TAGGED.findall(text)
        for said in sentences(text):
            if len(said.split()) > MOST:
                lost.append(f"{name}: more than {MOST} words: {said}")
            if guide and len(re.findall(r"(?<![\w.])\d[\d.,]*", said)) > 2:
                lost.append(f"{name}: more than two numbers: {said}")
        if guide and max(tables(text), default=0) > ROWS:
            lost.append(f"{name}: a table of more than {ROWS} rows")
    pictures = [p for kind in ("png", "svg") for p in DOCS.rglob(f"*.{kind}")]
    lost += [f"{p.relative_to(DOCS)}: on no page" for p in pictures if p.resolve() not in shown]
    lost += [f"{tag}: no equation has this number" for tag in cited() - {*numbers}]
    lost += [f"{tag}: an equation twice" for tag in {t for t in numbers if numbers.count(t) > 1}]
    return lost + [f"{name}: page or menu alone" for name in menu() ^ {*texts}]


def main() -> int:
    texts, wrong = pages(), faults()
    print(f"{len(texts)} pages, {sum(len(text.split()) for text in texts.values())} words")
    print(*wrong, sep="\n")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
