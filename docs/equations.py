"""Numbered equations of the pages, and links to them: a hook of mkdocs."""

import posixpath
import re
from pathlib import Path

DOCS = Path(__file__).resolve().parent
TAG = r"(?:[A-Z][A-Za-z]?)?\d+[a-z]?"
TAGGED = re.compile(r"\\tag\{([^}]*)\}")
FORMULA = re.compile(r'(<(?:span|div) class="arithmatex">.*?</(?:span|div)>)', re.DOTALL)
DISPLAY = re.compile(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', re.DOTALL)
# What a link to the theory is followed by: "), N6", "), N1–N20", "), C5, V5", "), T1 to T21".
SEVERAL = rf"\(?{TAG}(?:(?:, |–| to | and ){TAG})*(?!\w)"
CITED = re.compile(rf'(<a href="[^"#]*theory/[^"]*">[^<]*</a>\)?[,:] )({SEVERAL})')
NAMED = re.compile(rf"\(theory, ({SEVERAL})")
WITHIN = re.compile(rf"<(code|pre|math|a)\b.*?</\1>|<[^>]*>|\(({SEVERAL})\)", re.DOTALL)


def tags(text: str) -> list[str]:
    """Numbers of the equations of a page, in its order."""
    return TAGGED.findall(text)


def theory(texts: dict[str, str]) -> dict[str, str]:
    """Pages of the theory among those that are given by their paths below docs/."""
    return {name: text for name, text in texts.items() if name.startswith("theory")}


def where() -> dict[str, str]:
    """Address of the page of each equation, from the root of the site."""
    pages = [*DOCS.glob("theory*.md"), *sorted(DOCS.glob("theory/*.md"))]
    return {
        tag: re.sub(r"index/$", "", f"{page.relative_to(DOCS).with_suffix('').as_posix()}/")
        for page in pages
        for tag in tags(page.read_text(encoding="utf-8"))
    }


def on_page_content(content: str, page: object = None, **_: object) -> str:
    """Give each numbered equation its anchor, and lead what cites one there."""
    url, known = str(getattr(page, "url", "theory/")), where()

    def link(cited: str) -> str:
        return re.sub(TAG, lambda tag: _linked(tag[0], known, url), cited)

    content = CITED.sub(lambda found: found[1] + link(found[2]), content)
    content = NAMED.sub(lambda found: "(theory, " + link(found[1]), content)
    if url.startswith("theory/"):
        parts = FORMULA.split(content)
        parts[::2] = [
            WITHIN.sub(lambda found: f"({link(found[2])})" if found[2] else found[0], part)
            for part in parts[::2]
        ]
        content = "".join(parts)
    return DISPLAY.sub(_anchored, content)


def _linked(tag: str, known: dict[str, str], url: str) -> str:
    """The number as a link from the page at `url`, if there is such an equation."""
    if tag not in known:
        return tag
    path = "" if known[tag] == url else posixpath.relpath(known[tag], url or ".") + "/"
    return f'<a href="{path}#eq-{tag}">{tag}</a>'


def _anchored(found: re.Match) -> str:
    number = TAGGED.search(found[1])
    if number is None:
        return found[0]
    drawn = f'<div class="arithmatex">\\[{TAGGED.sub("", found[1])}\\]</div>'
    label = f'<span class="number">({number[1]})</span>'
    return f'<div class="equation" id="eq-{number[1]}">{drawn}{label}</div>'
