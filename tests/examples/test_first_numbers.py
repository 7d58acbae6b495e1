"""The first number of each table on the pages of the sources, from the functions of the page.

A case is the start of the row up to the number; counts are held to the page's exactly, others to
5 %, which two printed digits leave. The slow tests of test_paper_rows.py have the other tables.
"""

import re
from itertools import pairwise

import numpy as np
import pytest

from examples import diffusion, pressurised_crack
from examples.exact import poiseuille
from examples.neural_operator import WEIGHTS
from examples.polymer import ChannelFlow, Closure, PlaneFlow
from examples.polymer.plane import run_plane
from examples.studies import manufactured, paper_polymer_walls, paper_you_graining
from examples.studies import paper_polymer_gp as polymer
from examples.studies import paper_slides_incompressible as stiff
from examples.studies import paper_slides_rates as rates
from tests.examples.test_paper_rows import UNCERTIFIED, held, page_of, rows
from tools.graphene import sheet
from warp_peri import Bernstein, evaluate, load
from warp_peri.learning.fit import learn
from warp_peri.points.families import bond_classes


def of_a_known_kernel(best):
    """‖Lu − b‖/‖b‖ with 1/r itself, or of the best non-negative constant, on 5 Å."""
    samples = manufactured.manufactured(5.0)
    weight = manufactured.sample_weights([samples], normalise=False)[0]
    reduced = manufactured.reduce(samples, manufactured.HORIZON, weight, quadrature_degree=5)
    fitted = manufactured.positive_fit(reduced, 0, learn_alpha=False, seed=0)
    return manufactured.relative_residual(reduced, *(fitted if best else (1.0, np.ones(1))))


def between_plates():
    """Largest error of u/U while the first waves pass, De 1, 10³ dumbbells, of the first seed."""
    law, flow = printed_recipe(1.0), PlaneFlow(1.0, polymer.RE, polymer.CELLS, top=lambda t: 1.0)
    u, exact = (
        run_plane(flow, Closure(each, 1.0, polymer.CELLS), until=6.0, dt=0.01, every=20).u
        for each in (law, polymer.MAXWELL)
    )
    return np.abs(u - exact).max()


def printed_recipe(De):
    """The shear law of the printed recipe from 10³ dumbbells, of the first seed."""
    return polymer.shear_law(polymer.LAWS[0], De, 1000, 0)


def highest_in_the_channel():
    """Of the exact flow over its end, De 1e-3."""
    flow, t = ChannelFlow(1e-3), np.linspace(0, 0.1, 2001)
    u = poiseuille(np.array([0.5]), t, flow.De, flow.Re, flow.force)
    return u.max() / (flow.force / 8)


def of_one_draw(form):
    """Relative error of eight nodes a side, λ = 3μ, of the first of the page's draws."""
    points, horizon = stiff.scattered(8, 0)
    model = rates.plain(3 * rates.MU, rates.MU, horizon, 0.0)
    u, b = stiff.curl_and_pressure(points.x, 3)
    solved = stiff.forms(model, points)[form]().solve(b[None], u[None])[0]
    return np.linalg.norm(solved - u) / np.linalg.norm(u[points.interior])


def fixed_ratio():
    """Bond-based, eight nodes to a length, δ = 3h."""
    points = rates.lattice(8, 3 * rates.LENGTH / 8, rates.LENGTH)
    u = rates.no_dilatation(points.x)
    solid = rates.plain(rates.MU, rates.MU, 3 * rates.LENGTH / 8, points.spacing)
    return rates.error_of(solid, points, u, 2 * rates.MU * u)


QUICK = {
    (
        "you_2021",
        "Figure 1: a family",
        0,
        "| a sketch of a family, a bond and its force | the ",
    ): lambda: bond_classes(5.0, 20.0).count.sum(),
    ("you_2021", "Figures 2 and 3: a", 0, "| 1/r itself |"): lambda: of_a_known_kernel(False),
    ("you_2021", "Figures 2 and 3: a", 1, "| 1/r itself |"): lambda: of_a_known_kernel(False),
    ("you_2021", "Figures 2 and 3 by Adam", 0, "| M = 0 |"): lambda: of_a_known_kernel(True),
    ("you_2021", "Figure 4: lattice", 0, "| hexagonal lattice, "): lambda: len(sheet(1.46)[0]),
    ("you_2021", "Coarse graining", 0, "| δ = 2R + d | 21.46 Å, d = 1.46 Å the bond |"): None,
    ("you_2021", "The metric", 0, "| linear solid | E_res |"): None,  # test_examples.py
    ("you_2021", "Table 3 at 0 K", 0, "| 0 |"): None,
    ("you_2021", "Table 3 at 0 K", 1, "| 10 |"): None,
    ("polymer_gp", "Table 1 and Figure 7", 1, "| 0.001 |"): highest_in_the_channel,
    ("polymer_gp", "Table 1: the time step", 0, "| 8.6e-05 |"): lambda: (
        50 * int(np.ceil(0.03 / (0.5 * ChannelFlow(1e-2).longest_step) / 50))
    ),
    ("polymer_gp", "Figure 5: between", 0, "| 1 | printed recipe |"): between_plates,
    ("polymer_gp", "Averaging", 0, "| optimum |"): lambda: np.exp(
        printed_recipe(10.0).process.log_amplitude
    ),
    ("jafarzadeh_2024", "Figure 11: three", 1, "| 3 |"): lambda: load(
        WEIGHTS / "hgo_3.json"
    ).numbers(),
    ("polymer_gp", "Walls", 0, "| MSPH, as printed | 0 |"): lambda: (
        100 * paper_polymer_walls.poiseuille(15, 0.0, "MSPH, as printed")
    ),
    ("slides", "Functionals", 0, "| 2 | u | 2 | 12 | 3 |"): lambda: rates.functional(2, "u", 2)[
        "rate"
    ],
    ("slides", "Quadrature", 0, "| 2 | 1 | 2 | 48 | 4.0 |"): lambda: rates.pointwise(2, 1.0, 2)[
        "rate"
    ],
    ("slides", "To the nonlocal", 0, "| degree |"): lambda: rates.fixed_horizon((10,))["degree"][0],
    ("slides", "To the local", 0, "| bond-based, λ = μ |"): fixed_ratio,
    ("slides", "Damage", 0, "| 2 | 0.5 |"): lambda: float(rates.stretches()[0][2]),
    ("slides", "Free edges", 0, "| bond-based, the printed field |"): lambda: rates.free_edge(
        8, 1.0, corrected=True
    ),
    ("slides", "Near-incompressible solids\n", 0, "| as written (9) | 3 |"): lambda: of_one_draw(
        "as written (9)"
    ),
    ("slides", "Near-incompressible solids below", 0, "| as written (9) | 3 |"): lambda: (
        stiff.edge_error(8, 3, 0, "as written (9)")
    ),
    ("slides", "Near-incompressible solids with", 0, "| stiff in soft |"): lambda: (
        stiff.inclusion_error(12, "stiff in soft", 0)
    ),
    ("slides", "Diffusion in", 0, "| even, lattice |"): lambda: diffusion.smooth(8, 0.0),
    ("slides", "Diffusion coupled", 0, "| u |"): lambda: diffusion.coupled(8)[0],
    ("slides", "Pressure", 0, "| L/8 |"): lambda: pressurised_crack.opening(8)[0]["opening"],
    ("slides", "Neumann", 0, "| κ the same |"): lambda: diffusion.flux_jump(8, 1.0),
}
"""By page, section, table of the section and start of the row; None has a test of its own below."""
SLOW = {
    ("you_2021", "Algorithm 1"),
    ("you_2021", "Algorithm 1, step by step"), ("you_2021", "Table 4 at 0 K"),
    ("you_2021", "300 K: Tables 3 and 4"), ("you_2021", "300 K: Table 5"),
    ("you_2021", "300 K: an average of 24 000 steps"), ("you_2021", "The signal-to-noise ratio"),
    ("you_2021", "Table 6: two grids at once"), ("you_2021", "The metric (6.1)"),
    ("jafarzadeh_2024", "Figure 4: a test disk by the network"),
    ("jafarzadeh_2024", "Figure 5: graphene's errors, and its influence function"),
    ("jafarzadeh_2024", "Figure 7: sizes of the gradient"),
    ("jafarzadeh_2024", "Figure 10: a disk by the network"),
    ("jafarzadeh_2024", "Figure 11: three horizons"),
    ("jafarzadeh_2024", "Table 2, Figures 13 and 14: the leaflet"),
    ("polymer_gp", "Figure 4: the law in shear, De = 10"),
    ("polymer_gp", "Oscillating shear"),
    ("polymer_gp", "Table 1: the range of training"),
    ("polymer_gp", "Figures 6 and 9: how many training points"),
    ("polymer_gp", "Figure 8: forces at three heights"), ("polymer_gp", "What a run costs"),
}  # fmt: skip
"""Sections whose first number takes more than a few seconds, or data of minutes at 300 K: behind
the slow marker in test_paper_rows.py and test_neural.py."""
WORDS = re.compile(
    r"^\| \|? ?(printed \| here|parameter \| printed \| here)|linear solid \| crystal"
)
"""Headings of tables of words."""


def tables(page):
    """(section, number in it, heading line) of every table of a page."""
    text = page_of(page).split("\n*Made at")[0]
    found, section, count = [], "", 0
    lines = text.splitlines()
    for before, line in pairwise(lines):
        if line.startswith("## "):
            section, count = line[3:], 0
        elif re.fullmatch(r"\|[-|]+\|", line):
            found.append((section, count, before))
            count += 1
    return found


@pytest.fixture(scope="module")
def data(graphene):
    return load(graphene)


@pytest.mark.parametrize(
    "case",
    [case for case, f in QUICK.items() if f],
    ids=lambda case: f"{case[0]}, {case[1].strip()}, {case[2]}",
)
def test_the_first_number_of_a_table(case):
    page, section, number, start = case
    measured, told = QUICK[case](), rows(page, section, start)[-1 if number else 0]
    if isinstance(measured, (int, np.integer)):
        assert measured == told[0]
    else:  # between two numbers where the page has the least and the largest of some draws
        draws = {"Near-incompressible": (0, 1), "Figure 5: between": (1, 2)}
        ends = next((ends for name, ends in draws.items() if section.startswith(name)), (0, 0))
        assert told[ends[0]] / 1.05 < measured < 1.05 * told[ends[1]]


@pytest.mark.filterwarnings(UNCERTIFIED, "ignore:λ . μ ended on the lower bound")
def test_first_numbers_of_table_3(data):
    """From the page's own data."""
    model = learn(data["train"], horizon=10.0, kernel=Bernstein(0)).material
    residual, solved = (
        100 * evaluate(model, data[name], allow_uncertified=True, transfer=False)[key]
        for name, key in (("train", "E_res"), ("val", "E_u"))
    )
    held([10.0, residual], rows("you_2021", "Table 3 at 0 K", "| 0 |")[0][0:3:2])
    held([solved], [rows("you_2021", "Table 3 at 0 K", "| 10 |")[-1][0]])


def test_forces_between_nodes(tmp_path):
    found = paper_you_graining.forces_between_nodes(tmp_path)
    told = rows("you_2021", "Coarse graining", "| δ = 2R + d | 21.46 Å, d = 1.46 Å the bond |")[0]
    assert 20 + found["atoms"] == pytest.approx(told[0], abs=0.01)
    assert found["farthest"] <= 20 + found["atoms"]
    shares = rows("you_2021", "Coarse graining", "| part of Σ‖f(y, x)‖ beyond ")
    held([100 * share for share in found["share"]], [row[-1] for row in shares])
    assert found["left"] < 0.05  # of the loads, by the atoms' nonlinearity


def test_every_table_of_numbers_has_a_case_or_is_named():
    left = []
    for page in ("you_2021", "jafarzadeh_2024", "polymer_gp", "slides"):
        quick = [(section.strip(), n) for of, section, n, _ in QUICK if of == page]
        for section, number, heading in tables(page):
            known = any(section.startswith(start) and number == n for start, n in quick)
            if not (known or (page, section) in SLOW or WORDS.search(heading)):
                left.append((page, section, number))
    assert left == [("you_2021", "Figure 5, Tables 1 and 2: loads and displacements", 0)]
    # whose whole rows test_paper_rows.py has in the default suite
