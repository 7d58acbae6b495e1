"""Solve known problems with every material and compare with their references.

    make verify                                      # all rows
    python -m tests.known_problems NAFEMS Cook       # some, by parts of their names
    python -m tests.known_problems --scale           # in mm and in Å too, other moduli

Ends with 1 where a row does not hold that rows.toml expects to, or the other way round.
"""

import sys
from pathlib import Path

from tests.known_problems.rows import COLUMNS, as_csv, by_material, numbered, page, table, verified
from tools.options import NewFile, Options
from warp_peri.errors import exit_status
from warp_peri.files.atomic import content, write_text
from warp_peri.points.arguments import Count


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, options={
        "scale": (False, "in mm and Å, moduli × 1e6 and 1e-6"),
        "processes": (2, "number of processes", Count),
        "page": (Path, "file for the page; its data go beside it", NewFile),
    })  # fmt: skip
    some = "parts of names, or statics, cracks, motion"
    parser.add_argument("only", nargs="*", help=some)
    given = parser.parse_args(arguments)
    if given.page is not None:
        data, head = given.page.with_suffix(".csv"), ",".join(COLUMNS).encode()
        if data == given.page or (data.exists() and not content(data).startswith(head)):
            parser.error(f"--page: its data would replace {data}; name another")
    lines = verified(given.only, scaled=given.scale, processes=given.processes)
    if given.page is not None:
        write_text(given.page, page(lines, data.name))
        write_text(data, as_csv(lines))
    sources = numbered(lines)
    told = "\n".join(f"{n}. {source}." for source, n in sources.items())
    print(by_material(lines), table(lines, sources), told, sep="\n\n")
    return int(any(line["holds"] is bool(line["misses"]) for line in lines))


if __name__ == "__main__":
    sys.exit(exit_status(main))
