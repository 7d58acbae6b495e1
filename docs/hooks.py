"""What mkdocs does to the pages: tables of docs/record, commands, equations as MathML, figures."""

import html
import json
import posixpath
import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError

DOCS = Path(__file__).resolve().parent
RECORD = re.compile(r"^\[([^\]]+)\]\((?:\.\./)*record/(\w+)\.json#(\w+)\)$", re.MULTILINE)
"""A line that is nothing but a link to a table: [title](record/NAME.json#key)."""
TAG = r"(?:[A-Z][A-Za-z]?)?\d+[a-z]?"
TAGGED = re.compile(r"\\tag\{([^}]*)\}")
DISPLAY = re.compile(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', re.DOTALL)
FORMULA = re.compile(
    r'<(span|div) class="arithmatex">(?:\\\((.*?)\\\)|\\\[(.*?)\\\])</\1>', re.DOTALL
)
# What a link to the theory is followed by: "), N6", "), N1–N20", "), C5, V5", "), T1 to T21".
SEVERAL = rf"\(?{TAG}(?:(?:, |–| to | and ){TAG})*(?!\w)"
CITED = re.compile(rf'(<a href="[^"#]*theory/[^"]*">[^<]*</a>\)?[,:] )({SEVERAL})')
NAMED = re.compile(rf"\(theory, ({SEVERAL})")
WITHIN = re.compile(rf"<(code|pre|math|a)\b.*?</\1>|<[^>]*>|\(({SEVERAL})\)", re.DOTALL)
FIGURE = re.compile(r'<p>(<img [^>]*?src="([^"]+)"[^>]*>)</p>')
# What the converter leaves as it was typed behind \big and \Big.
DELIMITERS = dict(zip((r"\lvert", r"\rvert", r"\lVert", r"\rVert", r"\{", r"\}"), "||‖‖{}"))
BOOST = {"tutorials/": 3, "how-to/": 4, "explanation/": 2, "reference/messages": 6}
"""Weights of pages in the search; others have 1."""


def on_page_markdown(markdown: str, page: object, **_: object) -> str:
    """Put in what is not written by hand: tables of records, and the commands with their help."""
    if page.file.src_uri == "reference/commands.md":
        markdown += commands()
    return RECORD.sub(_table, markdown)


def on_page_content(content: str, page: object, **_: object) -> str:
    """Draw formulas, link equations and figures, and weigh the page for the search."""
    for folder, boost in BOOST.items():
        if page.file.src_uri.startswith(folder):
            page.meta["search"] = {"boost": boost} | (page.meta.get("search") or {})
    content = FIGURE.sub(r'<p><a class="figure" href="\2">\1</a></p>', linked(content, page.url))
    return FORMULA.sub(_drawn, content)


def _table(found: re.Match) -> str:
    title, name, key = found.groups()
    table = json.loads((DOCS / "record" / f"{name}.json").read_text("utf-8"))["tables"][key]
    rows = [table["columns"], ["---"] * len(table["columns"]), *table["rows"]]
    lines = [f"**{title}.** {table.get('caption', '')}", ""]
    lines += ["| " + " | ".join(str(cell) or " " for cell in row) + " |" for row in rows]
    if "commit" in table:
        made = (table["command"], table["commit"], table["date"])
        lines += ["", "`{}`, measured at {}, {}".format(*made)]
    return "\n".join(lines)


def commands() -> str:
    """Every command with its help, as sections."""
    from warp_peri.cli.main import COMMANDS, parser_of

    helps = {name: parser_of(name).format_help() for name in COMMANDS}
    return "".join(f"\n## {name}\n\n```text\n{text}```\n" for name, text in helps.items())


def tags(text: str) -> list[str]:
    """Numbers of the equations of a page, in its order."""
    return TAGGED.findall(text)


def linked(content: str, url: str) -> str:
    """Each numbered equation with its anchor, and what cites one led there, on the page `url`."""
    known = {
        tag: f"{page.relative_to(DOCS).with_suffix('').as_posix()}/"
        for page in sorted(DOCS.glob("theory/*.md"))
        for tag in tags(page.read_text(encoding="utf-8"))
    }

    def link(cited: str) -> str:
        return re.sub(TAG, lambda tag: one(tag[0]), cited)

    def one(tag: str) -> str:
        if tag not in known:
            return tag
        path = "" if known[tag] == url else posixpath.relpath(known[tag], url or ".") + "/"
        return f'<a href="{path}#eq-{tag}">{tag}</a>'

    content = CITED.sub(lambda found: found[1] + link(found[2]), content)
    content = NAMED.sub(lambda found: "(theory, " + link(found[1]), content)
    if url.startswith("theory/"):
        formula = r'(<(?:span|div) class="arithmatex">.*?</(?:span|div)>)'
        parts = re.split(formula, content, flags=re.DOTALL)
        parts[::2] = [
            WITHIN.sub(lambda found: f"({link(found[2])})" if found[2] else found[0], part)
            for part in parts[::2]
        ]
        content = "".join(parts)
    return DISPLAY.sub(_anchored, content)


def _anchored(found: re.Match) -> str:
    number = TAGGED.search(found[1])
    if number is None:
        return found[0]
    drawn = f'<div class="arithmatex">\\[{TAGGED.sub("", found[1])}\\]</div>'
    label = f'<span class="number">({number[1]})</span>'
    return f'<div class="equation" id="eq-{number[1]}">{drawn}{label}</div>'


def _drawn(found: re.Match) -> str:
    """MathML of a formula; a bar is a bracket, of its own height and without space around it."""
    inline, display = found[2], found[3]
    latex = html.unescape(inline if inline is not None else display)
    drawn = convert(latex, display="inline" if inline is not None else "block")
    for typed, sign in DELIMITERS.items():
        drawn = drawn.replace(f">{typed}<", f">{sign}<")
    bar = r'<mo lspace="0" rspace="0" stretchy="false">\1</mo>'
    drawn = re.sub(r"<mo>(&#x0007C;|&#x02016;)</mo>", bar, drawn)
    sized = r'<mrow><mo lspace="0" rspace="0" stretchy="true" \1</mo></mrow>'
    drawn = re.sub(r"<mo (minsize=.*?)</mo>", sized, drawn)
    over = r'<mover>((?:(?!<mover>).)*?)<mo accent="true">&#x02015;</mo></mover>'
    drawn = re.sub(over, r'<mrow class="overline">\1</mrow>', drawn)
    if re.search(r"[\\$]", drawn):
        raise PluginError(f"formula: expected LaTeX that can be drawn, got {latex}")
    return drawn if inline is not None else f'<div class="formula">{drawn}</div>'
