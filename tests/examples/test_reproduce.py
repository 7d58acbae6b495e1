"""What the scripts of examples/reproduce compute: claims of the papers, and rows of the records."""

import re

import numpy as np
from numpy.linalg import norm

from examples.reproduce import neural, slides, you_2021
from tests.support import ROOT, approx, clouds, filterwarnings, of_json, parametrize
from tests.support.problems import fitted_order
from tests.support.sheets import square
from warp_peri import Samples, load

RECORDS = {
    name: of_json(ROOT / "docs" / "record" / f"{name}.json")["tables"]
    for name in ("you_2021", "neural", "slides", "polymer")
}


def numbers(name, table, start):
    """Numbers of the first row of a table that starts so."""
    row = next(r for r in RECORDS[name][table]["rows"] if r[: len(start)] == start)
    return [float(n) for n in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", " ; ".join(row[len(start) :]))]


@parametrize("name", RECORDS)
def test_every_table_has_rows_of_its_columns_a_command_and_a_place_on_its_page(name):
    page = (ROOT / "docs" / "papers" / f"{name}.md").read_text("utf-8")
    for key, table in RECORDS[name].items():
        assert f"record/{name}.json#{key})" in page, key
        assert {len(row) for row in table["rows"]} == {len(table["columns"])}, key
        if "command" in table and "pytest" not in table["command"]:
            script, function = table["command"].removeprefix("python ").split()
            assert f"def {function}() -> Table:" in (ROOT / script).read_text("utf-8"), key


def test_quadrature_and_functionals_have_the_claimed_rates():
    for d, exponent in ((2, 3.5), (3, 2.5)):
        *_, claimed, rate = slides.pointwise(d, exponent, 3)
        assert float(rate) == approx(float(claimed), abs=0.1)
    for d, name, degree in ((2, "∂₁u", 3), (3, "∂₁∂₂u", 3)):
        *_, claimed, rate, share = slides.functional(d, name, degree)
        assert float(rate) == approx(float(claimed), abs=0.1)
        assert 0 < float(share) <= 1


def test_rows_of_the_slides_come_back(monkeypatch):
    """A code that weighs cells does not converge, and the quadrature does."""
    monkeypatch.setattr(slides, "CELLS", (8, 16, 32))
    found = slides.fixed_ratio()
    told = numbers("slides", "local_limit", ["bond-based, λ = μ"])
    assert found["cells"][-1] > found["cells"][0]
    assert found["bond"] == approx(told[:3], rel=0.05)
    told = numbers("slides", "edges", ["bond-based, the printed field"])[0]
    assert slides.free_edge(8, 1.0, corrected=True) == approx(told, rel=0.05)
    assert float(slides.stretches()[1][0][2]) == numbers("slides", "stretches", ["2", "0.5"])[0]
    for computed, table, start in (
        (slides.edge_error(8, 3, 0, "as written (9)"), "edge", ["as written (9)", "3"]),
        (slides.inclusion_error(12, "stiff in soft", 0), "inclusion", ["stiff in soft"]),
    ):
        least, most, *_ = numbers("slides", f"near_incompressible_{table}", start)
        assert least / 1.05 < computed < 1.05 * most


@parametrize(("ratio", "seed"), [(3.0, 0), (1e6, 2)])
def test_half_the_dilatations_have_second_order_however_incompressible(ratio, seed):
    lam, sides, errors = 0.8 * ratio, np.array([8, 16, 32]), []
    for number in sides:
        points = clouds.cloud(number, 6.0 / number, seed=seed, length=2.0)
        u, b = slides.curl_and_pressure(points.x, ratio)
        body = slides.staggered(clouds.plain(6.0 / number, lam, 0.8), points)
        errors.append(norm(body.solve(b[None], u[None])[0] - u) / norm(u[points.interior]))
    assert fitted_order(1 / sides, errors) > 1.9


@filterwarnings("ignore")
def test_rows_of_you_2021_come_back(graphene, monkeypatch):
    data = load(graphene)
    monkeypatch.setattr(you_2021, "data", lambda: data)
    rows = {row[0]: row[1:] for row in you_2021.loads()[1]}
    assert all(rows[name] == cells for name, *cells in RECORDS["you_2021"]["loads"]["rows"])
    model = you_2021.fitted(data["train"], 10.0, 0).material
    found = you_2021.errors_of(model, {n: data[n] for n in ("train", "val")})
    told = numbers("you_2021", "table_3", ["0"])[2:10:2]
    assert [100 * found[key] for key in you_2021.ERRORS] == approx(told, rel=0.01)
    reduced = you_2021.grid(5.0, 5)
    for row, fit in (
        ("1/r itself", (1.0, np.ones(1))),
        ("M = 4", you_2021.positive_fit(reduced, 4, learn_alpha=False, seed=0)),
    ):
        told = numbers("you_2021", "known_kernel", [row])[0]
        assert you_2021.relative_residual(reduced, *fit) == approx(told, rel=0.05)


def test_networks_have_the_printed_widths_and_rivals_find_their_own_numbers(graphene):
    sets = neural.sets_of("graphene", folder=graphene.parent)
    train, material = sets["train"], neural.weights_of("graphene")
    assert material.widths == {"influence": (256, 512), "state": (512, 512)}
    few = {"train": Samples(train.points, train.u[::35], train.b[::35])}
    error = neural.errors_of(material, few, solve=False)["E_res"]["train"]
    assert 100 * error == approx(numbers("neural", "graphene", ["network"])[0], rel=0.3)
    points = square(3)
    window = neural.Window(Samples(points, np.zeros((1, len(points.x), 2))))
    make, starts = neural.RIVALS["HGO, two fibre directions"]
    u = points.x @ [[0.2, 0.05], [0.1, 0.15]] + 0.03 * np.sin(3 * points.x)
    u[window.nodes[window.free]] = window.solve(make(np.array([1.5, 1.0, -0.5, 0.4])), u)
    _, left = neural.fit(window, make, np.array(starts[0]), Samples(points, u[None]))
    assert left < 1e-3
