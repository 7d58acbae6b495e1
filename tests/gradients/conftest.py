"""The table of gradients at the end of a run: material by verb, with the largest error found."""

from tests.gradients.cases import FOUND, VERBS


def pytest_terminal_summary(terminalreporter):
    if not FOUND:
        return
    write = terminalreporter.write_line
    terminalreporter.section("gradients against central differences, largest relative error")
    names = list(dict.fromkeys(material for material, _ in FOUND))
    wide = max(map(len, names))
    for verb in VERBS:
        rows = [(name, FOUND[name, verb]) for name in names if (name, verb) in FOUND]
        for name, errors in rows:
            cells = (k if v is None else f"{k} {v:.0e}" for k, v in errors.items())
            write(f"{verb:6} {name:{wide}}  {', '.join(cells)}")
