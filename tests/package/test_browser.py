"""The pages in a browser, where one is installed."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
SPEC = importlib.util.spec_from_file_location("browser", ROOT / "docs" / "browser.py")
browser = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(browser)

needs_browser = pytest.mark.skipif(browser.browser() is None, reason="no Chromium")


@needs_browser
def test_what_does_not_fit_and_is_not_drawn_is_found(tmp_path):
    style = '<meta charset="utf-8"><body style="margin: 0">'
    pages = {
        "good": "<article><table><tr><td>1</td></tr></table><p>short (a) [b] $1</p></article>",
        "wide": "<article><table style='width: 900px'><tr><td>1</td></tr></table></article>",
        "raw": r"<article><p>left: \[x^2\]</p></article>",
        "tall": "<article style='height: 15000px'></article>",
    }
    for name, body in pages.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "index.html").write_text(style + body, encoding="utf-8")
    found = browser.looked(tmp_path, [], timeout=60)
    assert browser.faults(found) == [
        "raw/ 1280: 1 formulas are not drawn",
        "raw/ 390: 1 formulas are not drawn",
        "tall/ 1280: 18.8 screens",
        "wide/ 390: wider than the screen, 0 tables",
    ]


@needs_browser
@pytest.mark.slow
def test_the_site_is_found_fits_a_phone_and_is_drawn(tmp_path):
    if importlib.util.find_spec("mkdocs") is None:
        pytest.skip("mkdocs is not installed: the extra docs")
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-d", tmp_path]
    subprocess.run(build, cwd=ROOT, check=True)
    assert browser.faults(browser.looked(tmp_path, list(browser.QUESTIONS))) == []
