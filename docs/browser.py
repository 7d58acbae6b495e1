"""The built site as a browser shows it: search, tables on a phone, heights, formulas.

python docs/browser.py [SITE]      (default: site/; the browser is Chromium, or what $BROWSER names)
"""

import functools
import http.server
import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
QUESTIONS = {
    "how do I use my own data": "how-to/arrays/",
    "free edges": "how-to/free_edges/",
    "error bar": "how-to/error_bars/",
    "DIC frames": "tutorials/dic/",
    "elastic constants from DFT": "how-to/calculators/",
    "certified on no spacing": "explanation/where_it_fails/",
}
"""What a reader types, and a page that has to be among the first three found."""
GENERATED = ("archive/", "reference/", "theory/", "papers/")
"""Pages that may be taller than SCREENS, since no one reads them from the top."""
SCREENS = 15
HARNESS = """<!doctype html><body><script>
const plan = PLAN, result = {pages: {}, search: {}};
const wait = (ms) => new Promise((done) => setTimeout(done, ms));
const open = async (page, width, height) => {
  const frame = Object.assign(document.createElement("iframe"), {width, height, src: "/" + page});
  document.body.append(frame);
  await new Promise((done) => { frame.onload = done; });
  await wait(50);
  return [frame, (what) => [...frame.contentDocument.querySelectorAll(what)]];
};
const wide = (part) => part.scrollWidth > part.clientWidth + 1;
const bare = (part) => !part.closest("code") && [...part.childNodes].some(
  (node) => node.nodeType == 3 && /\\\\\\(|\\\\\\[|\\$\\$/.test(node.data));
const look = async (page, width, height) => {
  const [frame, all] = await open(page, width, height);
  result.pages[page + " " + width] = {
    screens: frame.contentDocument.documentElement.scrollHeight / height,
    wide: all("html").some(wide) || all("body")[0].scrollWidth > width,
    tables: all(".md-typeset__scrollwrap, .md-typeset__table, table").filter(wide).length,
    formulas: all("math").filter((part) => !part.getBoundingClientRect().height).length
      + all("merror").length + all("article :is(p, li, td)").filter(bare).length,
  };
  frame.remove();
};
const ask = async (question) => {
  const [frame, all] = await open("", 1280, 800), [input] = all(".md-search__input");
  all("#__search")[0].click(), input.focus(), input.value = question;
  const found = () => all(".md-search-result__item > a");
  for (let i = 0; i < 100 && !found().length; i++) {
    for (const kind of ["keyup", "input"])
      input.dispatchEvent(new frame.contentWindow.Event(kind, {bubbles: true}));
    await wait(100);
  }
  await wait(200);
  result.search[question] = found().slice(0, 3).map((a) => new URL(a.href).pathname.slice(1));
  frame.remove();
};
(async () => {
  for (const question of plan.questions) await ask(question);
  for (const page of plan.pages) await Promise.all([look(page, 1280, 800), look(page, 390, 844)]);
  await fetch("/result", {method: "POST", body: JSON.stringify(result)});
})();
</script>"""


def browser() -> str | None:
    """Chromium of this machine."""
    names = (os.environ.get("BROWSER", ""), "chromium", "chromium-browser", "google-chrome")
    return next((path for name in names if (path := shutil.which(name))), None)


def looked(site: Path, questions: list[str], timeout: float = 300.0) -> dict:
    """What the browser measures on each page of a site at 1280 and 390 px, and what it finds."""
    pages = sorted(p.parent.relative_to(site).as_posix() for p in site.rglob("index.html"))
    plan = {"pages": ["" if p == "." else p + "/" for p in pages], "questions": questions}
    came: queue.Queue = queue.Queue()

    class Handler(http.server.SimpleHTTPRequestHandler):
        def do_POST(self) -> None:
            came.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_error(204)

        def translate_path(self, path: str) -> str:
            return str(start) if path == "/start.html" else super().translate_path(path)

        def log_message(self, *_: object) -> None:
            pass

    handler = functools.partial(Handler, directory=str(site))
    with (
        http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server,
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile,
    ):
        start = Path(profile, "start.html")
        start.write_text(HARNESS.replace("PLAN", json.dumps(plan), 1), encoding="utf-8")
        threading.Thread(target=server.serve_forever, daemon=True).start()
        options = ["--headless=new", "--no-sandbox", f"--user-data-dir={profile}/profile"]
        url = f"http://127.0.0.1:{server.server_port}/start.html"
        shown = subprocess.Popen([browser(), *options, url], stderr=subprocess.DEVNULL)
        try:
            return came.get(timeout=timeout)
        finally:
            shown.terminate()
            shown.wait()
            server.shutdown()


def faults(found: dict) -> list[str]:
    """What is wrong, a line each."""
    lines = []
    for question, pages in found["search"].items():
        if not any(page.startswith(QUESTIONS[question]) for page in pages):
            lines.append(f"'{question}' does not find {QUESTIONS[question]} but {pages}")
    for name, page in found["pages"].items():
        if (page["wide"] or page["tables"]) and not name.startswith("archive/"):
            lines.append(f"{name}: wider than the screen, {page['tables']} tables")
        if page["formulas"]:
            lines.append(f"{name}: {page['formulas']} formulas are not drawn")
        if page["screens"] > SCREENS and not name.startswith(GENERATED) and "1280" in name:
            lines.append(f"{name}: {page['screens']:.1f} screens")
    return lines


if __name__ == "__main__":
    if browser() is None:
        sys.exit("error: no Chromium here; $BROWSER names one")
    measured = looked(Path(sys.argv[1] if sys.argv[1:] else ROOT / "site"), list(QUESTIONS))
    wrong = faults(measured)
    print(*wrong, f"{len(measured['pages'])} views, {len(wrong)} faults", sep="\n")
    sys.exit(bool(wrong))
