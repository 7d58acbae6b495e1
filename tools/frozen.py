"""The library's numbers, written down once, so that a change of the code can be held to them.

    python tools/frozen.py check                     # every case again, one core, under a minute
    python tools/frozen.py check --only '^lps|solve' --class moved
    python tools/frozen.py record                    # write tests/frozen/record.json anew

The cases are in tools/frozen_cases.py; their materials are files that an earlier version saved, in
tests/frozen/, so that old files are read each time. What an entry may differ by is its class:
`moved` nothing, `resummed` 1e-12 of its size, `resolved` ten times the solver's tolerance,
`refitted` less than printed digits show, `proven` no lower in five digits, `residual` at most its
limit. Some state a limit of their own. `--class moved` or `resummed` holds all that are looser to
that. With another processor or packages than the record's, bits are no matter: moved is 1e-12.
"""

import hashlib
import json
import os
import platform
import re
import subprocess
import sys
import time
import warnings
from collections import Counter
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"  # before NumPy and torch, which read it once
ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
import torch

from tools.frozen_cases import CASES, FOLDER, Absent
from tools.options import Options
from warp_peri.errors import InputError, exit_status
from warp_peri.files.atomic import write_text
from warp_peri.runtime import set_num_threads

RECORD = FOLDER / "record.json"
LIMITS = {"moved": 0.0, "resummed": 1e-12, "resolved": 1e-7, "refitted": 2e-4, "proven": 1e-5}
"""Largest relative deviation of a class, where the entry states none."""
SAME = 1e-12
WHOLE, PLACES, SIGNS = 12, 4, 8
"""Size up to which an array is kept whole; values and sums that are kept of a larger one."""
VERDICTS = ("equal", "within 1e-12", "within class", "BEYOND", "skipped")


def machine() -> dict[str, str]:
    """What decides the last bits: the processor and the packages."""
    try:
        said = Path("/proc/cpuinfo").read_text()
    except OSError:
        said = ""
    names = dict(re.findall(r"^(model name|model)\s*: (.*)$", said, re.M)).values()
    parts = {"processor": " ".join([platform.machine(), *names])}
    packages = {name: version(name) for name in ("numpy", "scipy", "torch", "warp-lang")}
    return parts | {"python": platform.python_version()} | packages


def digest(data: bytes) -> str:
    """Sixteen letters of SHA-256."""
    return hashlib.sha256(data).hexdigest()[:16]


def kept(kind: str, value: Any, limit: float | None) -> dict[str, Any]:
    """What is written down of an entry.

    Of text the text. Of numbers hashes of their bits and of their first twelve digits, and values:
    all of a few; of many some, their norm, and sums under random signs, whose differences have the
    mean square of the norm of the difference.
    """
    entry: dict[str, Any] = {"class": kind} | ({} if limit is None else {"limit": limit})
    if isinstance(value, str):
        return entry | {"text": value}
    array = np.asarray(value, dtype=float)
    flat = np.ascontiguousarray(array).ravel()
    if not np.isfinite(flat).all():
        raise ValueError("expected finite numbers")
    largest = float(np.abs(flat).max(initial=0.0))
    unit = 10.0 ** (np.floor(np.log10(largest)) - 11) if largest > 0 else 1.0
    entry |= {"shape": list(array.shape), "bits": digest(flat.tobytes())}
    entry["digits"] = digest(np.rint(flat / unit).astype(np.int64).tobytes())
    if flat.size <= WHOLE:
        return entry | {"values": flat.tolist()}
    random = np.random.default_rng(flat.size)
    places = random.integers(flat.size, size=PLACES)
    signs = random.integers(2, size=(SIGNS, flat.size)) * 2.0 - 1
    sums = (signs * flat).sum(axis=1)
    norms = {"norm": float(np.linalg.norm(flat)), "largest": largest}
    return entry | norms | {"at": flat[places].tolist(), "sums": sums.tolist()}


def deviation(old: dict[str, Any], new: dict[str, Any]) -> float:
    """Relative difference of two entries, inf where they are not of one kind."""
    if "text" in old or "text" in new:
        return 0.0 if old.get("text") == new.get("text") else np.inf
    if old["shape"] != new["shape"]:
        return np.inf
    if old["bits"] == new["bits"]:
        return 0.0

    def off(name: str, size: float, mean: bool = False) -> float:
        difference = np.asarray(new[name]) - np.asarray(old[name])
        found = np.sqrt((difference**2).mean()) if mean else np.abs(difference).max()
        return float(found / size) if size > 0 else float(np.inf if found else 0.0)

    least = float(np.finfo(float).tiny)  # bits differ, and what is kept may not
    if "values" in old:
        return max(least, off("values", float(np.abs(old["values"]).max())))
    sums = off("sums", old["norm"], mean=True)
    return max(least, sums, off("at", old["largest"]), off("norm", old["norm"]))


def verdict(
    old: dict[str, Any], new: dict[str, Any], *, tightest: str = "", same_machine: bool = True
) -> tuple[str, float]:
    """How an entry stands beside its record, and its deviation; of a residual the value."""
    kind, off = old["class"], deviation(old, new)
    if off == 0:
        return VERDICTS[0], off
    limit = old.get("limit", LIMITS.get(kind, 0.0))
    if kind == "residual":
        value = new["values"][0]
        return VERDICTS[2 if value <= limit else 3], value
    if tightest:
        limit = min(limit, LIMITS[tightest])
    elif kind == "proven" and np.isfinite(off):
        worst = np.max((np.array(old["values"]) - new["values"]) / np.abs(old["values"]))
        if worst <= limit:
            return VERDICTS[1 if off <= SAME else 2], off
    if "text" not in old and not same_machine:
        limit = max(limit, SAME)
    if old.get("digits") == new.get("digits", "") and limit >= SAME:
        return VERDICTS[1], off
    return (VERDICTS[1] if off <= SAME else VERDICTS[2]) if off <= limit else VERDICTS[3], off


def computed(only: re.Pattern[str], names: set[str]) -> dict[str, Any]:
    """Entries by name: their record, or a string that says why there is none.

    A case runs where one of its names is asked for, or where none is known yet.
    """
    found: dict[str, Any] = {}
    for case, run in CASES.items():
        mine = {name for name in names if name.startswith(f"{case}: ")}
        if mine and not any(map(only.search, mine)):
            continue
        begin, why = time.perf_counter(), "the case has no such entry now"
        try:
            for label, kind, value, *limit in run():
                found[f"{case}: {label}"] = kept(kind, value, limit[0] if limit else None)
        except Absent as error:
            why = f"skipped: {error}"
        except Exception as error:
            why = f"{type(error).__name__}: {error}".splitlines()[0][:160]
        found |= {name: why for name in mine - found.keys()}
        if not mine and not why.startswith("the case"):
            found[f"{case}: all"] = why
        print(f"  {case}, {time.perf_counter() - begin:.1f} s", file=sys.stderr)
    chosen(only, found.keys() | names)
    return {name: entry for name, entry in found.items() if only.search(name)}


def chosen(only: re.Pattern[str], names: Iterable[str]) -> list[str]:
    """Those of the names that have the pattern; InputError where none has."""
    if not (found := [name for name in names if only.search(name)]):
        known = ", ".join(dict.fromkeys(name.split(":")[0] for name in sorted(names)))
        raise InputError(
            f"only: expected a pattern of some entry, got {only.pattern}; there are {known}"
        )
    return found


def record(only: re.Pattern[str]) -> int:
    """Write all entries, or those that are asked for beside the others; 1 where one failed.

    The head says where and of which commit all were written: a part is written there alone.
    """
    known = json.loads(RECORD.read_text()) if RECORD.exists() else {"entries": {}}
    if only.pattern and not machine().items() <= known.items():
        raise InputError("only: expected the record's machine and packages; record all here")
    found = computed(only, set())
    failed = {name: why for name, why in found.items() if isinstance(why, str)}
    for name, why in failed.items():
        print(f"{name}: {why}")
    if failed:
        return 1
    rest = {n: e for n, e in known["entries"].items() if not only.search(n)}
    commit = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.strip()
    commit = known["commit"] if only.pattern else commit
    lines = [f"{json.dumps(n)}: {json.dumps(e)}" for n, e in sorted((rest | found).items())]
    start = json.dumps({"commit": commit} | machine(), indent=1)[:-2]
    body = ",\n  ".join(lines)
    write_text(RECORD, f'{start},\n "entries": {{\n  {body}\n }}\n}}\n')
    print(f"{len(lines)} entries, {RECORD.stat().st_size / 1000:.0f} kB")
    return 0


def check(only: re.Pattern[str], *, tightest: str = "", every: bool = False) -> int:
    """Print a table of what differs (of all, with `every`) and the counts; 1 if any is beyond."""
    before = json.loads(RECORD.read_text())
    entries, same = before["entries"], machine().items() <= before.items()
    found = computed(only, set(entries))
    counts: Counter[str] = Counter()
    for name in sorted(found.keys() | {n for n in entries if only.search(n)}):
        new, old = found.get(name, "its case is gone"), entries.get(name)
        if isinstance(new, str):
            stands, shown = VERDICTS[4 if new.startswith("skipped") else 3], new
        elif old is None:
            stands, shown = VERDICTS[3], "not in the record"
        else:
            stands, off = verdict(old, new, tightest=tightest, same_machine=same)
            shown = f"{off:.1e} ({old['class']})"
            if "text" in old and stands == VERDICTS[3]:
                shown = f"{old['text'][:60]!r} became {new.get('text', '')[:60]!r}"
        counts[stands] += 1
        if every or stands != VERDICTS[0]:
            print(f"{stands:13} {name}: {shown}")
    where = "the machine of the record" if same else "another machine than the record's"
    print(", ".join(f"{counts[v]} {v}" for v in VERDICTS if counts[v]) + f", on {where}")
    return int(counts[VERDICTS[3]] > 0)


def main(arguments: list[str] | None = None) -> int:
    """Status of the command."""
    options = {
        "only": ("", "of entries whose names have this pattern", re.compile),
        "every": (False, "print entries that are equal too"),
        "list": (False, "print the names and do nothing"),
    }
    parser = Options(__doc__, options=options)
    parser.add_argument("verb", choices=("record", "check"))
    parser.add_argument("--class", dest="tightest", choices=("moved", "resummed"), default="")
    given = parser.parse_args(arguments)
    if given.list:
        entries = json.loads(RECORD.read_text())["entries"]
        print(*(f"{entries[n]['class']:9} {n}" for n in chosen(given.only, entries)), sep="\n")
        return 0
    set_num_threads(1)
    torch.set_num_threads(1)
    with warnings.catch_warnings(action="ignore"):  # of transfers, of strains: said to users
        if given.verb == "record":
            return record(given.only)
        return check(given.only, tightest=given.tightest, every=given.every)


if __name__ == "__main__":
    sys.exit(exit_status(main))
