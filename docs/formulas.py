"""Formulas of the pages as MathML, which browsers draw by themselves: a hook of mkdocs."""

import html
import re

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError

# What the converter leaves as it was typed behind \big and \Big.
DELIMITERS = dict(zip((r"\lvert", r"\rvert", r"\lVert", r"\rVert", r"\{", r"\}"), "||‖‖{}"))
# A bar is a bracket here, of its own height and without the space that an operator has around it.
BAR = re.compile(r"<mo>(&#x0007C;|&#x02016;)</mo>")
SIZED = re.compile(r"<mo (minsize=.*?)</mo>")
OVERLINE = re.compile(r'<mover>((?:(?!<mover>).)*?)<mo accent="true">&#x02015;</mo></mover>')
FORMULA = re.compile(
    r'<(span|div) class="arithmatex">(?:\\\((.*?)\\\)|\\\[(.*?)\\\])</\1>', re.DOTALL
)


def on_page_content(content: str, **_: object) -> str:
    """Replace what arithmatex marked in the HTML of a page."""
    return FORMULA.sub(_drawn, content)


def _drawn(found: re.Match) -> str:
    inline, display = found[2], found[3]
    latex = html.unescape(inline if inline is not None else display)
    drawn = convert(latex, display="inline" if inline is not None else "block")
    for typed, sign in DELIMITERS.items():
        drawn = drawn.replace(f">{typed}<", f">{sign}<")
    drawn = BAR.sub(r'<mo lspace="0" rspace="0" stretchy="false">\1</mo>', drawn)
    drawn = SIZED.sub(r'<mrow><mo lspace="0" rspace="0" stretchy="true" \1</mo></mrow>', drawn)
    drawn = OVERLINE.sub(r'<mrow class="overline">\1</mrow>', drawn)
    if re.search(r"[\\$]", drawn):
        raise PluginError(f"formula: expected LaTeX that can be drawn, got {latex}")
    if inline is not None:
        return drawn
    return f'<div class="formula">{drawn}</div>'
