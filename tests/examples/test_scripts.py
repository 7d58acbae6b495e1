"""Every script of examples/ runs at a small size, and finds the number that it is about."""

import importlib
import json
import re
import runpy
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

import warp_peri as wp
from examples.figures import check_place
from tests.support import ROOT, approx, filterwarnings, of_json, parametrize, slow, sup
from tests.support.plates import MODEL

FOLDER = ROOT / "examples"
LAWS = {"linear": 3.0, "third_order": 0.094, "crystal": 0.95, "neural": 15.0, "cracks": None,
        "diffusion": None}  # fmt: skip
"""Error on the unseen disks that is not to be passed [%], of laws learned from graphene."""
COMMANDS = {
    "branching": (
        "--spacing 1e-3 --ratio 3 --time 4e-6 --out . --series",
        lambda found: found["nodes"] == 4000 and Path("series/motion.pvd").exists()
        and Path("damage.png").stat().st_size > 5000,
    ),
    "plate_with_hole": (
        "--spacing 1 --horizon 3 --radius 8 --half 32 --size 0.6 --model model.json --out .",
        lambda found: found["u_error"] < 5e-4 and found["hoop_stress_error"] < 0.01,
    ),
    "inclusion_from_displacement": ("--side 14 --steps 25", lambda found: found["map error"] < 0.2),
    "waves_to_map": (
        "--side 20 --iterations 12",
        lambda found: all(found[name] < 0.6 * found[f"{name} at start"] for name in ("κ", "μ")),
    ),
    "toughness_from_crack": (
        "--iterations 5 --out .", lambda found: found["error of stretch"] < 0.1
    ),
}  # fmt: skip
"""Options of a small size, and what holds of the numbers printed."""


@pytest.fixture(autouse=True)
def _no_options(monkeypatch):
    monkeypatch.setattr("sys.argv", [""])
    monkeypatch.setattr("examples.figures.RUNS", Path("runs"))


@parametrize("name", LAWS)
def test_a_law_in_a_few_lines(name, graphene, here):
    (here / "data").symlink_to(graphene.parent)
    names = runpy.run_path(str(FOLDER / "laws" / f"{name}.py"))
    plt.close("all")
    assert check_place(f"runs/{name}.png").stat().st_size > 5000  # may be drawn again
    if name == "cracks":
        assert names["run"].missing < 2e-3
    elif name == "diffusion":  # no extremes inside
        assert sup(names["solution"].u[names["points"].interior]) < sup(names["phi"])
    else:
        assert 100 * names["error"] < LAWS[name]


@parametrize(("name", "number", "value"), [
    ("learn_from_arrays", "mu", approx(0.7, rel=1e-3)),
    ("solve_disk", "relative error of u", approx(0, abs=5e-3)),
    ("own_influence", "radius", approx(9.0, rel=1e-5)),
])  # fmt: skip
def test_a_script_finds_its_number(name, number, value, here):
    assert runpy.run_path(str(FOLDER / f"{name}.py"))["numbers"][number] == value
    plt.close("all")


@filterwarnings("ignore:loads")
@parametrize(
    "name", [pytest.param(n, marks=[slow] * (n == "toughness_from_crack")) for n in COMMANDS]
)
def test_a_command_errs_by_no_more(name, here, capsys):
    wp.save("model.json", MODEL.in_units(("nm", "GPa")))
    options, holds = COMMANDS[name]
    assert importlib.import_module(f"examples.{name}").main(options.split()) == 0
    assert holds(json.loads(capsys.readouterr().out))


def test_a_law_of_ones_own_goes_through_every_verb(here, capsys):
    law = runpy.run_path(str(FOLDER / "own_law.py"), run_name="__main__")["law"]
    assert not [*here.iterdir()]  # where a user's files are
    error, proven, still, swung = map(float, capsys.readouterr().out.split())
    assert type(law).__name__ == "Springs"
    assert wp.certify(law).symbol_bound == law.certificate.proven == proven > 0.19
    assert law.elastic_tensor()[0, 1] == approx(0.5, rel=0.02)  # λ = μ, as of all springs
    assert error < 5e-3  # three numbers for the four lengths of its bonds
    assert 0.9 * still < swung < still


def test_a_ball_swells_and_a_penny_runs_as_the_textbook_says():
    from examples.penny_crack import torn
    from examples.solid_in_space import swollen

    *_, error, proven = swollen(0.1)
    assert (error < 4e-3, proven) == (True, approx(0.355, rel=1e-2))
    _, motion, stress = torn(side=14, radius=3.0, steps=200)
    assert stress.max() == approx(1.0, abs=0.15)  # of Griffith
    assert stress[-1] < 0.2  # it has come apart
    assert motion.missing < 0.02


@filterwarnings("ignore")
@parametrize("name", ["gradients", "own_fields", "crystal"])
def test_a_notebook_prints_what_it_shows(name, capsys, here):
    """But for digits, of which the last are the machine's."""
    known, digits = {}, re.compile(r"-?\d[\d.e+-]*")
    for cell in of_json(FOLDER / "notebooks" / f"{name}.ipynb")["cells"]:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), known)
            shown = "".join(line for output in cell["outputs"] for line in output["text"])
            assert digits.sub("0", capsys.readouterr().out) == digits.sub("0", shown)
