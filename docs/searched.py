"""What the search of the site finds first, and what it leaves out: a hook of mkdocs."""

import re

BOOST = {
    "explanation/where_it_fails.md": 6,  # messages
    "how-to/arrays.md": 6,
    "tutorials/": 3,
    "how-to/": 4,
    "explanation/": 2,
}
"""Weight of a page, or of the pages of a folder; the first that fits counts. Others have 1."""
LEFT_OUT = ("archive/",)
MEMBER = re.compile(r'<h[2-6] (?=[^>]*class="doc doc-heading")')


def on_page_content(content: str, page: object, **_: object) -> str:
    """Weigh a page by its folder, and hide the members of the API."""
    path = page.file.src_uri
    search = dict(page.meta.get("search") or {})
    if path.startswith(LEFT_OUT):
        search.setdefault("exclude", True)
    for folder, boost in BOOST.items():
        if path.startswith(folder):
            search.setdefault("boost", boost)
    page.meta["search"] = search
    if path.startswith("reference/api/"):
        return MEMBER.sub(lambda found: f"{found[0]}data-search-exclude ", content)
    return content
