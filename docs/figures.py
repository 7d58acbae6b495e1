"""Figures of the pages link to themselves, to be read at full size: a hook of mkdocs."""

import re

FIGURE = re.compile(r'<p>(<img [^>]*?src="([^"]+)"[^>]*>)</p>')


def on_page_content(content: str, **_: object) -> str:
    """Make every figure that stands alone a link to its own file."""
    return FIGURE.sub(r'<p><a class="figure" href="\2">\1</a></p>', content)
