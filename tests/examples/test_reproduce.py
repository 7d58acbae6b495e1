"""What the scripts of examples/reproduce compute: claims of the papers, and rows of the records."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from examples.exact import continuum_symbol
from examples.reproduce import neural, slides, you_2021
from tests.support import clouds
from tests.support.problems import fitted_order, lattice
from tests.support.sheets import square
from tools.make_hgo import SQUARES, square_points
from warp_peri import InputError, Points, Samples, load
from warp_peri.neural import NeuralOperator

ROOT = Path(__file__).resolve().parents[2]
RECORDS = {
    name: json.loads((ROOT / "docs" / "record" / f"{name}.json").read_text("utf-8"))["tables"]
    for name in ("you_2021", "neural", "slides", "polymer")
}


def numbers(name, table, start):
    """Numbers of the first row of a table that starts so."""
    row = next(r for r in RECORDS[name][table]["rows"] if r[: len(start)] == start)
    return [
        float(n) for cell in row[len(start) :] for n in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", cell)
    ]


@pytest.mark.parametrize("name", RECORDS)
def test_every_table_has_rows_of_its_columns_and_is_on_its_page(name):
    page = (ROOT / "docs" / "papers" / f"{name}.md").read_text("utf-8")
    for key, table in RECORDS[name].items():
        assert f"record/{name}.json#{key})" in page, key
        assert {len(row) for row in table["rows"]} == {len(table["columns"])}, key
        if "command" in table and "pytest" not in table["command"]:
            script, function = table["command"].removeprefix("python ").split()
            assert f"def {function}() -> Table:" in (ROOT / script).read_text("utf-8"), key


@pytest.mark.parametrize(("d", "exponent"), [(2, 1.0), (2, 3.5), (3, 2.5)])
def test_the_quadrature_has_the_claimed_rate(d, exponent):
    *_, claimed, rate = slides.pointwise(d, exponent, 3)
    assert float(rate) == pytest.approx(float(claimed), abs=0.1)


@pytest.mark.parametrize(("d", "name", "degree"), [(2, "∂₁u", 3), (3, "u", 2), (3, "∂₁∂₂u", 3)])
def test_functionals_have_the_claimed_rate_and_keep_the_bound(d, name, degree):
    *_, claimed, rate, share = slides.functional(d, name, degree)
    assert float(rate) == pytest.approx(float(claimed), abs=0.1)
    assert 0 < float(share) <= 1


def test_a_code_that_weighs_cells_does_not_converge_and_the_quadrature_does(monkeypatch):
    monkeypatch.setattr(slides, "CELLS", (8, 16, 32))
    found = slides.fixed_ratio()
    assert found["cells"][-1] > found["cells"][0]
    assert found["bond"][-1] < found["bond"][0] / 15
    told = numbers("slides", "local_limit", ["bond-based, λ = μ"])
    assert found["bond"] == pytest.approx(told[:3], rel=0.05)


def test_rows_of_the_slides_come_back():
    assert slides.free_edge(8, 1.0, corrected=True) == pytest.approx(
        numbers("slides", "edges", ["bond-based, the printed field"])[0], rel=0.05
    )
    assert float(slides.stretches()[1][0][2]) == numbers("slides", "stretches", ["2", "0.5"])[0]
    for compute, table, start in (
        (slides.edge_error(8, 3, 0, "as written (9)"), "near_incompressible_edge",
         ["as written (9)", "3"]),
        (slides.inclusion_error(12, "stiff in soft", 0), "near_incompressible_inclusion",
         ["stiff in soft"]),
    ):  # fmt: skip
        least, most, *_ = numbers("slides", table, start)
        assert least / 1.05 < compute < 1.05 * most


def staggered_error(number, lam, seed):
    horizon = 6.0 / number
    points = clouds.cloud(number, horizon, seed=seed, length=2.0)
    u = clouds.state_based_field(points.x, lam, 0.8)
    b = clouds.state_based_load(points.x, lam, 0.8)
    solved = slides.staggered(clouds.plain(horizon, lam, 0.8), points).solve(b[None], u[None])[0]
    return np.linalg.norm(solved - u) / np.linalg.norm(u[points.interior])


@pytest.mark.parametrize(("ratio", "seed"), [(3.0, 0), (1e6, 2)])
def test_half_the_dilatations_have_second_order_however_incompressible(ratio, seed):
    sides = np.array([8, 16, 32])
    errors = [staggered_error(side, 0.8 * ratio, seed) for side in sides]
    assert fitted_order(1 / sides, errors) > 1.9
    cube = np.argwhere(np.ones(3 * [9])) - 4.0
    with pytest.raises(InputError, match="points of the plane"):
        slides.staggered(clouds.plain(2.0), Points(cube, np.abs(cube).max(axis=1) < 0.5, 0.0))


def test_the_known_kernel_has_the_long_waves_of_elasticity_and_the_rows_of_the_record():
    n, (lam, mu) = np.array([0.6, 0.8]), (you_2021.LAM, you_2021.MU)
    D = continuum_symbol(1e-3 * n, lam, mu, 12.5) / 1e-6
    np.testing.assert_allclose(D, mu * np.eye(2) + (lam + mu) * np.outer(n, n), rtol=0, atol=1e-5)
    reduced = you_2021.grid(5.0, 5)
    loss = you_2021.relative_residual(reduced, 1.0, np.ones(1))
    assert loss == pytest.approx(numbers("you_2021", "known_kernel", ["1/r itself"])[0], rel=0.01)
    fitted = you_2021.positive_fit(reduced, 4, learn_alpha=False, seed=0)
    told = numbers("you_2021", "known_kernel", ["M = 4"])[0]
    assert you_2021.relative_residual(reduced, *fitted) == pytest.approx(told, rel=0.05)


@pytest.mark.filterwarnings("ignore")
def test_rows_of_you_2021_come_back(graphene, monkeypatch):
    data = load(graphene)
    monkeypatch.setattr(you_2021, "data", lambda: data)
    rows = {row[0]: row[1:] for row in you_2021.loads()[1]}
    for name, *cells in RECORDS["you_2021"]["loads"]["rows"]:
        assert rows[name] == cells
    model = you_2021.fitted(data["train"], 10.0, 0).material
    found = you_2021.errors_of(model, {n: data[n] for n in ("train", "val")})
    told = numbers("you_2021", "table_3", ["0"])[2:10:2]
    assert [100 * found[key] for key in you_2021.ERRORS] == pytest.approx(told, rel=0.01)
    assert you_2021.printed_ratios()[2] == pytest.approx(0.0543, rel=0.01)


def test_networks_have_the_printed_widths_and_the_residual_of_the_record(graphene):
    sets = neural.sets_of("graphene", folder=graphene.parent)
    train, material = sets["train"], neural.weights_of("graphene")
    assert material.widths == {"influence": (256, 512), "state": (512, 512)}
    few = {"train": Samples(train.points, train.u[::35], train.b[::35])}
    errors = neural.errors_of(material, few, solve=False)["E_res"]["train"]
    assert 100 * errors == pytest.approx(numbers("neural", "graphene", ["network"])[0], rel=0.3)


def test_a_network_is_trained_from_a_fresh_start(tmp_path, monkeypatch):
    points = lattice(4, 3.0)
    u = 0.02 * np.sin(points.x + np.arange(4)[:, None, None])
    sets = {name: Samples(points, u, u) for name in ("train", "val")}
    small = NeuralOperator(3.0, (4, 4), (8, 8))
    monkeypatch.setattr(neural, "fresh", lambda name, units: (small, neural.Training(batch=2)))
    assert neural.trained("graphene", tmp_path, 2, sets).provenance["epochs"] == 2
    assert load(tmp_path / "graphene.json").numbers() == small.numbers()


@pytest.mark.parametrize(("name", "side"), [("square", 21), ("square_4", 25), ("square_5", 29)])
def test_equations_hold_where_surroundings_are_data_and_the_mirror_continues(name, side):
    pytest.importorskip("skfem")
    points = square_points(name)
    assert (len(points.x), points.interior.sum()) == (side**2, 81)
    if name == "square":
        u = points.x @ np.array([[0.1, 0.2], [0.0, 0.3]])
        wide = neural.mirrored(Samples(points, u[None], np.ones((1, *u.shape))), SQUARES[name])
        np.testing.assert_allclose(wide.u[0], wide.x @ [[0.1, 0.2], [0.0, 0.3]], atol=1e-12)
        assert wide.interior.sum() == 19**2


def test_rivals_of_the_leaflet_find_their_own_numbers():
    pytest.importorskip("skfem")
    points = square(3)
    window = neural.Window(Samples(points, np.zeros((1, len(points.x), 2))))
    make, starts = neural.RIVALS["HGO, two fibre directions"]
    truth = np.array([1.5, 1.0, -0.5, 0.4])
    u = points.x @ np.array([[0.2, 0.05], [0.1, 0.15]]) + 0.03 * np.sin(3 * points.x)
    u[window.nodes[window.free]] = window.solve(make(truth), u)
    _, left = neural.fit(window, make, np.array(starts[0]), Samples(points, u[None]))
    assert left < 1e-3
    x, y = (points.x - points.x.mean(axis=0)).T
    cubic = np.stack([x**3 - x * y**2, 1 + y**3 + x**2 * y], axis=1)
    samples = Samples(points, np.stack([cubic, cubic + x[:, None] ** 4]))
    exact, beyond = neural.interpolated_errors(samples)
    assert exact < 1e-12 < 1e-6 < beyond
