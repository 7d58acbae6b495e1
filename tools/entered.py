"""Files of the library, kernels apart, that a first fit and a first solve of graphene enter."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import warp_peri as wp
from tools.options import Options
from warp_peri.errors import exit_status


def entered(call: Callable[..., Any], *given: Any, **options: Any) -> Any:
    """What a call returns; prints the files below warp_peri that have code which it ran."""
    seen, package = set(), f"{ROOT / 'warp_peri'}/"
    sys.setprofile(lambda frame, *_: seen.add(frame.f_code.co_filename))
    result = call(*given, **options)
    sys.setprofile(None)
    names = sorted(name.removeprefix(package) for name in seen if name.startswith(package))
    files = [name for name in names if not name.startswith("kernels")]
    print(f"{call.__name__}: {len(files)} files: {', '.join(files)}")
    return result


def main() -> int:
    parser = Options(__doc__)
    parser.add_argument("--data", type=Path, default=ROOT / "data" / "graphene_0K.h5")
    data, law = wp.load(parser.parse_args().data), wp.LPS(20.0, wp.Bernstein(8))
    problem = wp.Dirichlet(data["val"], data["val"].loads[0], data["val"].u[0])
    entered(wp.solve, entered(wp.fit, data["train"], law, progress=False).material, problem)
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
