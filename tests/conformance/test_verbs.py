"""Verbs that take every material for which they mean something, and what a person sees of it."""

from dataclasses import replace
from functools import partial
from unittest.mock import Mock

import numpy as np
import torch

import warp_peri as wp
from tests.support import assert_refused, filterwarnings, parametrize
from tests.support.fields import solved_samples
from tests.support.materials import LAWS, placed
from tests.support.plates import plate
from tests.support.problems import OTHER
from tests.support.solving import solve
from warp_peri.core import pointwise
from warp_peri.materials import lps_force
from warp_peri.materials.hyperelastic import operator as tissue

pytestmark = filterwarnings("ignore:strain:UserWarning")
SEEN = {
    "LPS": ("λ, μ 300, 800 GPa", "3 Å", "0.15 TPa", "certified on 1 Å"),
    "third order, energy": ("t3, tq2, q3", "-500, -6800, 1040 GPa", "|H| = 3.00%", "C11, C12, C44"),
    "density": ("1 Å", "saint_venant", "1000 GPa", "lam 0.4", "mu 0.9"),
    "hyperelastic": ("0.1 Å", "deviation (", "GPa", "stretch of the data not known"),
}


def of(name, side=2, copies=1):
    op, _ = placed(name, side)
    one = solved_samples(op)
    return LAWS[name].material(), op, replace(one, u=np.tile(one.u, (copies, 1, 1)),
                                              b=np.tile(one.b, (copies, 1, 1)))  # fmt: skip


@parametrize(
    ("name", "place"),
    [
        ("LPS", (lps_force, "families_of")),
        ("third order, energy", (pointwise, "grid_of")),
        ("hyperelastic", (tissue, "SheetLattice")),
    ],
)
def test_a_material_is_placed_once(name, place, monkeypatch):
    material, _, samples = of(name)
    monkeypatch.setattr(*place, spy := Mock(wraps=getattr(*place)))
    op = material.on(samples.points)
    wp.evaluate(op, samples)
    solve(op, samples.points, samples.b, samples.u)
    assert spy.call_count == 1


def test_a_linear_part_is_certified_and_its_material_diagnosed():
    material, op, _ = of("LPS")
    assert wp.certify(op) == wp.certify(material, spacing=1.0)
    cubic, on, many = of("third order, energy", 4, 4)
    assert wp.certify(cubic, spacing=1.0) == wp.certify(on) == wp.certify(cubic.linear, spacing=1)
    assert wp.diagnose(material, many).residual > 1e-3
    assert wp.diagnose(cubic, many).causes == ["rounding"]


def test_what_a_verb_does_not_mean_is_refused_by_name():
    solid, _, many = of("hyperelastic", copies=4)
    name, body = "HyperelasticMaterial", wp.Body(plate(3.0, 12.0, 2, 8), {"sides": (0, 0)})
    lps, problem = LAWS["LPS"].material(), wp.Dirichlet(many.points, many.b, many.u)
    assert wp.solve(solid, problem, transfer=False, allow_uncertified=True).residual < 1e-6
    assert_refused({
        f"certify: expected .*, got {name}": lambda: wp.certify(solid, spacing=0.1),
        f"diagnose: expected .*, got {name}": lambda: wp.diagnose(solid, many),
        f"prove_uniqueness: expected .*, got {name}":
            lambda: wp.certificates.prove_uniqueness(solid, spacing=0.1),
        "evaluate: expected a material.*, got Points": lambda: wp.evaluate(many.points, many),
        "solve: expected a material.*, got Tensor":
            lambda: solve(torch.ones(3), many.points, many.b, many.u),
        f"solve: spacings: not among .* {name}": lambda: wp.solve(solid, problem, spacings=1.0),
        "transfer: expected True or False": lambda: wp.solve(solid, problem, transfer="no"),
        r"solver: expected none for a Body.*, got Direct\(":
            lambda: wp.solve(lps, body, solver=wp.Direct()),
    } | {
        f"among allow_uncertified, got {one}": partial(wp.solve, lps, body, **{one: False})
        for one in ("transfer", "coupling", "tolerance")
    })  # fmt: skip


def test_a_material_shows_what_it_is():
    for name, parts in SEEN.items():
        material = LAWS[name].material()
        text, table = repr(material), material._repr_html_()
        assert text.splitlines()[0] == type(material).__name__
        for part in parts:
            assert part in " ".join(text.split())
        assert table.startswith("<table>")
        assert table.count("<tr>") == len(text.splitlines()) - 1
        other = repr(material.in_units(OTHER))
        assert "GPa" in other
        assert "TPa" not in other
    model = replace(LAWS["LPS"].material(), errors={"test": {"E_res": 0.021, "E_u": 0.0042}})
    assert "errors on test E_res 2.10%, E_u 0.42%" in " ".join(repr(model).split())


def test_data_show_their_size():
    samples = replace(of("LPS", 4)[2], arrays={"wave_vector": np.ones((2, 2))})
    for shown in map(repr, (samples, samples.points)):
        assert "256, 16 of them interior, a lattice of 1 Å" in shown
    assert samples.points._repr_html_().startswith("<table>")
    assert "TPa/Å" in repr(samples)
    assert "b" in repr(replace(samples, b=None)).split("not known")[0]
    data = wp.Dataset({"train": samples, "test": samples}, 3.35, 2200.0)
    assert "train      2 samples on nodes: 256" in repr(data)
    assert "3.35 Å" in data._repr_html_()
