"""Forward solves of a model on the held-out disks: errors disk by disk, and their picture."""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import warp_peri
from examples import graphene_report as report
from tools.options import Options
from warp_peri.errors import exit_status
from warp_peri.files.atomic import write_json

DATA = ROOT / "data" / "graphene_0K.h5"


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, defaults=True)
    parser.add_argument("model", type=Path, metavar="MODEL", help="a model.json")
    parser.add_argument("--data", type=Path, default=DATA, help="HDF5 file with the disks")
    parser.add_argument("--set", default="test", help="name of the set")
    parser.add_argument("--out", type=Path, help="folder for the results (default: the model's)")
    parser.add_argument("--allow-uncertified", action="store_true")
    given = parser.parse_args(arguments)
    out = given.out or given.model.parent
    model = warp_peri.load(given.model)
    points = warp_peri.load(given.data)[given.set]
    table = warp_peri.evaluate(model, points, allow_uncertified=given.allow_uncertified)
    report.draw_disks(out / f"{given.set}.png", model, points, table)
    write_json(out / f"{given.set}.json", table)
    names = points.arrays.get("load_id", range(1, len(points) + 1))
    width = max(len(str(name)) for name in [*names, "mean"])
    print(f"{'load':{width}}  E_u [%]  ‖L u − b‖ [TPa/Å]")
    for name, u, b in zip(names, table["E_u_samples"], table["E_res_abs_samples"]):
        print(f"{name!s:{width}}  {100 * u:7.3f}  {b:17.3e}")
    print(f"{'mean':{width}}  {100 * table['E_u']:7.3f}  {table['E_res_abs']:17.3e}")
    print(f"picture: {out / f'{given.set}.png'}")
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
