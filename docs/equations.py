"""Numbered equations of the pages, and links to them: a hook of mkdocs."""

import re

TAG = r"(?:[A-Z][A-Za-z]?)?\d+[a-z]?"
TAGGED = re.compile(r"\\tag\{([^}]*)\}")
FORMULA = re.compile(r'(<(?:span|div) class="arithmatex">.*?</(?:span|div)>)', re.DOTALL)
DISPLAY = re.compile(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', re.DOTALL)
# What a link to the theory is followed by: "), N6", "), N1–N20", "), C5, V5", "), T1 to T21".
SEVERAL = rf"\(?{TAG}(?:(?:, |–| to | and ){TAG})*(?!\w)"
CITED = re.compile(rf'(<a href="([^"#]*theory/)[^"]*">[^<]*</a>\)?[,:] )({SEVERAL})')
NAMED = re.compile(rf"\(theory\.md, ({SEVERAL})")
WITHIN = re.compile(rf"<(code|pre|math|a)\b.*?</\1>|<[^>]*>|\(({TAG})\)", re.DOTALL)


def tags(text: str) -> list[str]:
    """Numbers of the equations of a page, in its order."""
    return TAGGED.findall(text)


def on_page_content(content: str, page: object = None, **_: object) -> str:
    """Give each numbered equation its anchor, and lead what cites one there."""
    url = str(getattr(page, "url", "theory/"))
    content = CITED.sub(lambda found: found[1] + _linked(found[3], found[2]), content)
    theory = "../" * len(url.strip("./").split("/") if url.strip("./") else "") + "theory/"
    content = NAMED.sub(lambda found: "(theory, " + _linked(found[1], theory), content)
    if url == "theory/":
        parts = FORMULA.split(content)
        known = {*tags(content)}
        parts[::2] = [_within(part, known) for part in parts[::2]]
        content = "".join(parts)
    return DISPLAY.sub(_anchored, content)


def _linked(cited: str, page: str) -> str:
    return re.sub(TAG, lambda tag: f'<a href="{page}#eq-{tag[0]}">{tag[0]}</a>', cited)


def _within(text: str, known: set[str]) -> str:
    def link(found: re.Match) -> str:
        return f'(<a href="#eq-{found[2]}">{found[2]}</a>)' if found[2] in known else found[0]

    return WITHIN.sub(link, text)


def _anchored(found: re.Match) -> str:
    number = TAGGED.search(found[1])
    if number is None:
        return found[0]
    drawn = f'<div class="arithmatex">\\[{TAGGED.sub("", found[1])}\\]</div>'
    label = f'<span class="number">({number[1]})</span>'
    return f'<div class="equation" id="eq-{number[1]}">{drawn}{label}</div>'
