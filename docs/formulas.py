"""Formulas of the pages as MathML, which browsers draw by themselves: a hook of mkdocs."""

import html
import re

from latex2mathml.converter import convert

FORMULA = re.compile(
    r'<(span|div) class="arithmatex">(?:\\\((.*?)\\\)|\\\[(.*?)\\\])</\1>', re.DOTALL
)


def on_page_content(content: str, **_: object) -> str:
    """Replace what arithmatex marked in the HTML of a page."""
    return FORMULA.sub(_drawn, content)


def _drawn(found: re.Match) -> str:
    inline, display = found[2], found[3]
    latex = html.unescape(inline if inline is not None else display)
    number = re.search(r"\\tag\{(\d+)\}", latex)
    drawn = convert(
        re.sub(r"\\tag\{\d+\}", "", latex), display="inline" if inline is not None else "block"
    )
    if inline is not None:
        return drawn
    label = f'<span class="number">({number[1]})</span>' if number else ""
    return f'<div class="formula">{drawn}{label}</div>'
