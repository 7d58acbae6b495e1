"""A Lennard-Jones sheet from its own dumps: the constants of its statics, soft as it may be."""

import numpy as np
import pytest

from tools.networks import SHEET, lennard_jones, make_dumps, springs
from warp_peri import Bernstein, evaluate
from warp_peri.cli.main import main
from warp_peri.learning.fit import learn as fit
from warp_peri.points.dataset import load_dataset


def sampled(folder, network, *, force=1.0):
    """The training set that the command makes of a network's dumps, and forces times a factor."""
    dumps, forces, rest = make_dumps(folder, network)
    for path in forces:
        np.savetxt(path, force * np.loadtxt(path, delimiter=","), delimiter=",", fmt="%.17g")
    nodes = [
        "--spacing",
        8,
        "--radius",
        24,
        "--reach",
        88,
        "--interior",
        45,
        "--box",
        *network.box,
        *SHEET,
    ]
    words = ["coarse-grain", *dumps, "--force", *forces, "--reference", rest, *nodes]
    status = main([str(word) for word in [*words, "--out", folder / "data.h5", "--json"]])
    assert status == 0
    return load_dataset(folder / "data.h5")["train"]


def test_the_statics_of_the_sheet_are_those_of_its_pair_forces():
    """Isotropic, with Cauchy's relation C12 = C44 of pair forces, from sums over the shells."""
    C = lennard_jones((8, 5)).moduli()
    assert C["C11"] == pytest.approx(C["C22"], rel=1e-9)
    assert C["C12"] == pytest.approx(C["C44"], rel=1e-6)
    assert C["C11"] == pytest.approx(3 * C["C44"], rel=1e-6)
    weak, strong = springs((8, 5), weak=1.0, factor=0.5), springs((8, 5), weak=0.0)
    for name, value in strong.moduli().items():
        assert weak.moduli()[name] == pytest.approx(value / 2)


@pytest.mark.slow
def test_constants_from_dumps_are_those_of_the_statics(tmp_path, capsys):
    """Loads times 0.01 are those of a sheet a hundred times as soft."""
    sheet, force = lennard_jones((52, 30)), 0.01
    data = sampled(tmp_path, sheet, force=force)
    learned = fit(data, 20.0, Bernstein(4), progress=False)
    true = {name: force * value for name, value in sheet.moduli().items()}
    for name in ("C11", "C12", "C44"):
        assert learned.moduli[0][name] == pytest.approx(true[name], rel=0.03)
    assert learned.material.mu == pytest.approx(true["C44"], rel=0.03)
    assert learned.material.lam == pytest.approx(true["C12"], rel=0.03)
    assert evaluate(learned.material, data)["E_u"] < 0.01
