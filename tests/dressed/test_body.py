"""Bodies that are uneven, end at edges, or are broken."""

from dataclasses import replace

import numpy as np
import pytest

import warp_peri as wp
from tests.dressed.solids import ISOTROPIC, SPACING, nodes, rigid, solid
from tests.micromodulus.crystals import cubic_tensor, lattice
from tests.support.bodies import random_breaking
from warp_peri.core.elastic import voigt
from warp_peri.damage import BrittleCrystal, lattice_body
from warp_peri.damage.operator import bond_matrix
from warp_peri.dressed import grown, torn
from warp_peri.dressed.sweeps import ByLayers, dilatation_range
from warp_peri.dynamics.verlet import inertia
from warp_peri.errors import InputError
from warp_peri.launch import set_threads, threads

BONDS = cubic_tensor(2, **ISOTROPIC)
REACHES = {2: (1.0, 2**0.5, 2.0, 5**0.5), 3: (1.0, 2**0.5, 3**0.5)}


def random_body(seed):
    """Nodes, maps and broken pairs at random, of any base and any G."""
    rng = np.random.default_rng(seed)
    d = 2 + seed % 2
    base = "bonds" if d == 2 and rng.random() < 0.5 else "elements"
    reach = REACHES[d][rng.integers(len(REACHES[d]))]
    p = 1 / 8 + (base == "bonds") * rng.integers(2) * rng.uniform(-1, 1) * dilatation_range(BONDS)
    law = solid(d, base, reach, 0.05, bool(rng.integers(2)), seed, p)
    n = {2: 10, 3: 4}[d]
    points = nodes(d, n, rng.random(n**d) < rng.uniform(0.9, 1))
    x = points.x
    there = rng.random(len(x)) < 0.8  # the rest has no stiffness at all
    maps = {name: there * 100 ** -rng.random(len(x)) for name in law.parts.names}
    near = np.abs(x[:, None] - x).max(axis=2) < 1.1 * SPACING
    pairs = np.argwhere(np.triu(near, 1))
    broken = pairs[
        rng.random(len(pairs))
        < rng.uniform(0, {"bonds": 0.5, "elements": {2: 0.1, 3: 0.02}[d]}[base])
    ]
    return law.on(points, edges=True, maps=maps, broken=broken)


def check(body):
    """No negative eigenvalue, and nothing for a rigid motion, in parts of the largest entry.

    Returns whether there is anything left of the body.
    """
    L = body.L.toarray()
    size = np.abs(L).max()
    assert np.linalg.eigvalsh(L)[0] >= -1e-12 * size
    assert np.abs(body(rigid(body.points))).max() <= 1e-12 * size * np.abs(body.points.x).max()
    return bool(size > 0)


@pytest.mark.parametrize("count", [20, pytest.param(1000, marks=pytest.mark.slow)])
def test_nothing_makes_a_body_unstable_or_resist_a_turn(count):
    assert sum(check(random_body(seed)) for seed in range(count)) > 0.9 * count


def test_the_check_sees_bonds_that_resist_a_turn():
    """The even law's own bonds, cut at the edge, are not objective."""
    law = solid()
    body = law.on(nodes(2, 10), edges=True)
    steps, tensors = law.crystal.steps, law.crystal.tensors
    place = body._neighbours(steps)
    L = np.zeros((100, 2, 100, 2))
    for near, C in zip(place.T, tensors):
        own = np.flatnonzero(near >= 0)
        for i, j in zip(own, near[own]):
            L[i, :, i] += C
            L[j, :, j] += C
            L[i, :, j] -= C
            L[j, :, i] -= C
    turn = rigid(body.points)[2].ravel()
    forces = [np.abs(K @ turn).max() for K in (L.reshape(200, 200), body.L)]
    assert forces[0] > 1e6 * forces[1]


@pytest.mark.parametrize(("d", "base"), [(2, "elements"), (2, "bonds"), (3, "elements")])
def test_far_from_its_edges_a_body_is_the_even_law(d, base):
    law = solid(d, base, split=True)
    n = {2: 16, 3: 9}[d]
    reach = 4 * SPACING
    points = nodes(
        d, n, interior=lambda x: ((x > reach - 0.1) & (x < x.max() - reach + 0.1)).all(axis=1)
    )
    u = np.random.default_rng(0).normal(size=points.x.shape)
    even = law.on(points)
    body = law.on(points, edges=True)
    np.testing.assert_allclose(body(u), even(u), atol=1e-12 * np.abs(even(u)).max())
    with pytest.raises(InputError, match="or edges=True where"):
        law.on(nodes(d, n))
    with pytest.raises(InputError, match="edges=True"):
        law.on(nodes(d, n), maps={"bulk": np.ones(n**d)})


def test_a_period_is_the_even_law_and_linear_in_its_maps():
    law = solid(split=True)
    points = wp.Points.sheet((9, 10), SPACING)
    rng = np.random.default_rng(1)
    u, first = rng.normal(size=points.x.shape), 1 + rng.random(len(points.x))
    names = law.parts.names
    assert names == ("tetragonal", "shear", "bulk")
    ones = law.on(points, maps={"bulk": np.ones(len(points.x))})
    np.testing.assert_allclose(ones(u), law.on(points)(u), atol=1e-12)
    each = sum(
        law.on(points, maps={m: first if m == n else 0 * first for m in names})(u) for n in names
    )
    whole = law.on(points, maps=dict.fromkeys(names, first))(u)
    np.testing.assert_allclose(each, whole, atol=1e-12)
    assert np.abs(whole - ones(u)).max() > 0.1


def test_the_bound_of_a_map_is_its_smallest_value():
    """L ≥ min(map) L of the even solid (theory, Dr11)."""
    law = solid()
    points = wp.Points.sheet((8, 8), SPACING)
    rng = np.random.default_rng(2)
    maps = {name: 0.3 + rng.random(64) for name in law.parts.names}
    uneven, even = (
        law.on(points, maps=m).L.toarray() for m in (maps, dict.fromkeys(maps, np.ones(64)))
    )
    gap = np.linalg.eigvalsh(uneven - min(m.min() for m in maps.values()) * even)
    assert gap[0] >= -1e-12 * np.abs(even).max()


@pytest.mark.parametrize("broken", [None, [[44, 45], [54, 55]]])
def test_a_free_body_stretches_as_a_solid_does(broken):
    """Forces on two sides; a body torn in two along its middle would not carry them."""
    law = solid()
    points = nodes(2, 10)
    x = points.x
    b = np.zeros_like(x)
    width = np.where((x[:, 1] == x[:, 1].min()) | (x[:, 1] == x[:, 1].max()), 0.5, 1.0)
    b[:, 0] = 0.01 * width * ((x[:, 0] == x[:, 0].max()) * 1.0 - (x[:, 0] == 0)) / SPACING
    body = law.on(points, edges=True, broken=broken)
    solution = wp.solve(body, wp.Dirichlet(points, b, np.zeros_like(x)))
    assert solution.residual < 1e-9
    np.testing.assert_allclose(body(solution.u), b, atol=1e-12)
    u = solution.u
    stretch = (u[-10:, 0].mean() - u[:10, 0].mean()) / np.ptp(x[:, 0])
    compliance = np.linalg.inv(law.elastic)[0, 0] * 0.01
    if broken is None:
        assert stretch == pytest.approx(compliance, rel=1e-9)
    else:
        assert 1.02 * compliance < stretch < 1.5 * compliance
    assert body.energy(u) == pytest.approx(0.5 * SPACING**2 * (b * u).sum())
    with pytest.raises(InputError, match="balance"):
        wp.solve(body, wp.Dirichlet(points, np.ones_like(x), np.zeros_like(x)))


def test_an_outline_cuts_elements_by_their_share():
    """A disk under uniform radial tension at its rim grows by what its moduli say."""
    law = solid()
    points = nodes(2, 24)
    middle, R = points.x.mean(axis=0), 10 * SPACING

    def inside(x):
        return np.linalg.norm(x - middle, axis=1) < R

    body = law.on(points, edges=inside)
    assert body.share.sum() * SPACING**2 == pytest.approx(np.pi * R**2, rel=2e-3)
    used = body.stiffness.any(axis=1)
    assert body.masses[used].sum() == pytest.approx(body.share.sum(), rel=1e-12)
    assert ((0 < body.share) & (body.share < 1)).any()
    assert check(body)
    strain = (points.x - middle) * 0.01
    energy = 0.5 * 1e-4 * law.elastic[:2, :2].sum() * body.share.sum() * SPACING**2
    assert body.energy(strain) == pytest.approx(energy)
    with pytest.raises(InputError, match="bonds"):
        solid(base="bonds").on(points, edges=inside)


@pytest.mark.parametrize("d", [2, 3])
def test_a_node_has_the_mass_of_its_part_of_the_elements(d):
    """A block weighs what its elements do, and swings about its middle as a block does."""
    points = nodes(d, 6)
    masses = solid(d).on(points, edges=True).masses
    x = points.x / SPACING
    sides = ((x == 0) | (x == 5)).sum(axis=1)
    np.testing.assert_array_equal(masses, 0.5**sides)
    hole = (np.abs(x - 2.5) < 1).all(axis=1)
    dead = {name: np.where(hole, 0.0, 1.0) for name in solid(d).parts.names}
    assert solid(d).on(points, edges=True, maps=dead).masses.sum() == 5**d - 1
    if d == 2:
        assert (solid(base="bonds").on(points, edges=True).masses == 1).all()


def test_a_free_bar_swings_as_the_theory_says():
    """With whole cells at its edges it was 7 % too slow, and its energy is kept to rounding."""
    points = nodes(2, 8)
    body = solid().on(points, edges=lambda x: np.linalg.norm(x - 4.55, axis=1) < 4)
    step = 0.99 * 2 * np.sqrt(inertia(1e3, body.model.units) / body.stiffest_wave())
    u = np.random.default_rng(0).normal(size=points.x.shape) * (body.stiffness > 0)
    how = {"density": 1e3, "steps": 400}
    run = wp.move(body, wp.Dirichlet(points, None, u), step=step, **how)
    assert run.drift < 1e-11
    assert np.abs(run.u).max() < 30 * np.abs(u).max()
    with pytest.raises(InputError, match="step: expected at most"):
        wp.move(body, wp.Dirichlet(points, None, u), step=1.02 * step, **how)


def test_the_longest_step_is_the_same_in_all_units_and_every_time():
    points = nodes(2, 8)
    found = [solid().on(points, edges=True).stiffest_wave() for _ in range(2)]
    law, units = solid(), ("m", "MPa")
    metres = wp.Points(1e-10 * points.x, points.interior, 1e-10 * SPACING, units=units)
    other = law.in_units(units).on(metres, edges=True).stiffest_wave()
    assert found[0] == found[1]
    assert other * 1e-20 / 1e6 == pytest.approx(found[0], rel=1e-12)


def test_a_crack_parts_its_faces():
    """Two halves torn apart do not feel one another, through G neither."""
    law = solid(base="bonds", reach=2.0, size=0.05)
    points = nodes(2, 10)
    middle = 4.5 * SPACING
    above = points.x[:, 1] > middle
    broken = torn(points, [[(-1, middle), (20, middle)]])
    assert len(broken) == 10 + 2 * 9
    body = law.on(points, edges=True, broken=broken)
    u = above[:, None] * np.array([0.3, 1.0])
    assert np.abs(body(u)).max() < 1e-14
    assert np.abs(law.on(points, edges=True)(u)).max() > 0.1


def test_a_crack_costs_what_it_costs_the_base():
    """G changes no energy and so no critical load; what the base answers is u = G⁻¹ v (Dr12)."""
    law = solid(base="bonds", reach=2.0, size=0.05)
    points = nodes(2, 15, interior=lambda x: (np.abs(x - 7 * SPACING) < 6.5 * SPACING).all(axis=1))
    crack = [[(-1, 7.4 * SPACING), (6.6 * SPACING, 7.4 * SPACING)]]
    held = np.where(points.interior[:, None], 0.0, points.x * [0.0, 0.01])
    # a node is held by its row of G, which is not whole within one spacing of the edge
    body = law.on(points, edges=True, broken=torn(points, crack))
    rim = np.abs(body.dressings[0].toarray() - np.eye(450)).max(axis=1).reshape(-1, 2).max(axis=1)
    assert (rim[~points.interior] == 0).all()
    u = wp.solve(body, wp.Dirichlet(points, np.zeros_like(held), held)).u
    base = wp.solve(law.plain, wp.damage.Cracked(points, u=held, cracks=crack))
    assert body.energy(u) == pytest.approx(base.energy(), rel=1e-10)
    np.testing.assert_allclose(body.displacement(base.u), u, atol=1e-10)
    np.testing.assert_allclose(body.base_displacement(u), base.u, atol=1e-10)
    assert np.abs(u - base.u).max() > 1e-3 * np.abs(u).max()
    with pytest.raises(InputError, match="got elements"):
        _ = solid().plain
    with pytest.raises(InputError, match="got two influence functions"):
        _ = replace(law, dilatation=0.15).plain
    with pytest.raises(InputError, match="split"):
        solid(split=True).on(points, edges=True).displacement(u)


def crystal(size=0.02):
    """A base of bonds that is no isotropic sheet, under a short G."""
    C = np.array([[3.1, 0.7, 0.1], [0.7, 2.4, 0.2], [0.1, 0.2, 0.9]])
    return replace(solid(2, "bonds", 1.0, size), elastic=C, symmetry="1")


def test_a_crystals_bonds_are_those_that_break_whatever_is_broken():
    law, points = crystal(), nodes(2, 9)
    np.testing.assert_allclose(voigt(law.crystal.tensor()), law.elastic, atol=1e-12)
    body = lattice_body(points.x, SPACING, law.plain.horizon)
    neighbour = random_breaking(body, np.random.default_rng(3), 0.4)
    node, bond = np.nonzero((neighbour < 0) & (body.neighbour >= 0))
    broken = np.stack([node, body.neighbour[node, bond]], axis=1)
    bonds = law.plain.bonds(body.classes)
    expected = bond_matrix(body, neighbour, *bonds)
    even = replace(law, tensors=0 * law.tensors).on(points, edges=True, broken=broken)
    np.testing.assert_allclose(even.L.toarray(), expected.toarray(), atol=1e-12)
    torn_body = law.on(points, edges=True, broken=broken)
    values = np.linalg.eigvalsh(torn_body.L.toarray())
    assert values[0] > -1e-13 * values[-1]
    far = lattice(2, 3, 9, SPACING)
    rng = np.random.default_rng(0)
    maps = {name: rng.uniform(0, 2, len(far.x)) for name in law.parts.names}
    u = rng.normal(size=far.x.shape)
    whole = law.on(far, edges=True, maps=maps)(u)
    np.testing.assert_allclose(law.on(far, maps=maps)(u), whole, atol=1e-12 * np.abs(whole).max())


def test_a_crystal_cleaves_in_the_base_and_the_atoms_show_it():
    """Dr12: what growth costs the base it costs the dressed body."""
    law = crystal()
    points = nodes(2, 13, interior=lambda x: np.abs(x[:, 1] - 6 * SPACING) < 3.5 * SPACING)
    middle = 6.5 * SPACING
    pull = np.sign(points.x - 6 * SPACING) * ~points.interior[:, None] * [0.0, 1.0]
    brittle = BrittleCrystal(law.plain, 1.0, np.eye(2), np.ones(2))
    problem = wp.damage.Cracked(points, u=pull, cracks=[[(-1, middle), (middle, middle)]])
    before, growth = (wp.move(brittle, problem, events=events) for events in (5, 6))
    body = law.on(points, edges=True, broken=grown(points, before))
    v = growth.u / growth.time[-1]
    assert body.energy(body.displacement(v)) == pytest.approx(growth["energy"][-1], rel=1e-9)
    assert growth["energy"][-1] < growth["energy"][0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"maps": {"hardness": np.ones(100)}}, "maps: expected some of"),
        ({"maps": {"bulk": np.ones(99)}}, "expected 100 numbers ≥ 0"),
        ({"maps": {"bulk": -np.ones(100)}}, "the smallest -1"),
        ({"broken": [[0, 100]]}, "numbers of nodes below 100"),
        ({"broken": [0, 1]}, "pairs of nodes"),
        ({"edges": lambda x: x[:, 0]}, "one bool a position"),
        ({"dtype": np.float16}, "dtype: expected float64 or float32, got float16"),
    ],
)
def test_what_does_not_fit_is_refused(options, message):
    if callable(options.get("edges")):
        options = {"edges": lambda x: np.ones(3, bool)}
    with pytest.raises(InputError, match=message):
        solid().on(nodes(2, 10), **({"edges": True} | options))


@pytest.mark.parametrize(("base", "p"), [("elements", 1 / 8), ("bonds", 1 / 8), ("bonds", 0.2)])
@pytest.mark.parametrize("periodic", [True, False])
def test_layers_are_the_crystal_and_an_uneven_sheet_the_matrix(base, p, periodic):
    """L as G, K, G by rows: of even solids, on one precision and two, and with maps."""
    law = solid(2, base, 2.0 if base == "bonds" else 2**0.5, dilatation=p)
    points = wp.Points.sheet((15, 18), SPACING) if periodic else lattice(2, 5, 7, SPACING)
    rng = np.random.default_rng(0)
    u = rng.normal(size=(2, *points.x.shape))
    placed, known = law.on(points), law.crystal.on(points, method="rows")
    assert isinstance(placed.pull, ByLayers)
    expected, size = known(u), np.abs(known(u)).max()
    np.testing.assert_allclose(placed(u), expected, atol=1e-14 * size)
    single = law.on(points, dtype=np.float32)(u)
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, expected, atol=1e-5 * size)
    maps = {name: rng.uniform(0, 2, len(points.x)) for name in law.parts.names}
    body = law.on(points, maps=maps)
    by_matrix = (body.L @ u.reshape(2, -1).T).T.reshape(u.shape)[:, points.interior]
    np.testing.assert_allclose(body(u), by_matrix, atol=1e-13 * size)
    single = law.on(points, maps=maps, dtype=np.float32)(u)
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, by_matrix, atol=1e-5 * size)


def varied(kind):
    """Bodies with grains, outlines, holes and cracks, on a period too."""
    d = 3 if "space" in kind else 2
    law = solid(d, "bonds" if "bonds" in kind else "elements", 2.0 if d == 2 else 3**0.5)
    if "crystal" in kind:
        law = crystal()
    n = {2: 14, 3: 8}[d]
    points = nodes(d, n)
    x, middle = points.x, points.x.mean(axis=0)
    if "period" in kind:
        points = wp.Points(x, points.interior, SPACING, box=(n * SPACING,) * d)
    if "hole" in kind:
        points = nodes(d, n, np.linalg.norm(x - middle - 0.3, axis=1) > 2.5 * SPACING)
    options = {"edges": True}
    if "outline" in kind:
        options["edges"] = lambda y: np.linalg.norm(y - middle, axis=1) < 0.43 * n * SPACING
    if "crack" in kind:
        ends = [(middle[0] + side * SPACING, middle[1]) for side in (-2, 3)]
        options["broken"] = torn(nodes(d, n), [ends], reach=3.0 if "crystal" in kind else 1.5)
    if "grains" in kind:
        few = [
            replace(law, tensors=law.tensors * share, elastic=law.elastic * (2 - share))
            for share in (1, 0.7, 1.2, 0.5)
        ]
        options["grains"] = few, np.random.default_rng(1).integers(4, size=len(points.x))
        if "columns" in kind:
            options["grains"] = few, (4 * points.x[:, 0] / (n * SPACING)).astype(int)
    return law.on(points, **options)


@pytest.mark.parametrize("kind", [
    "edges, elements", "crack", "period, crack", "period, crack, bonds", "crack, bonds",
    "hole, bonds", "hole", "crack, crystal", "outline", "grains", "period, grains, columns",
    "grains, bonds", "hole, space", "outline, space", "period, grains, space",
])  # fmt: skip
def test_any_body_goes_by_rows_and_is_its_matrix(kind):
    body = varied(kind)
    fields = np.random.default_rng(0).normal(size=(2, *body.points.x.shape))
    flat = body.flat(fields).T
    expected = body.L @ flat
    np.testing.assert_allclose(body.in_turn(flat), expected, atol=1e-13 * np.abs(expected).max())
    inner = (expected.T.reshape(fields.shape) @ body.axes.T)[:, body.points.interior]
    np.testing.assert_allclose(body(fields), inner, atol=1e-13 * np.abs(inner).max())
    diagonal = sum(K.diagonal() for K in body.layers)
    np.testing.assert_allclose(body.stiffness.ravel(), diagonal, atol=1e-13 * diagonal.max())
    options = body._made_of[1] | {"dtype": np.float32}
    single = type(body)(*body._made_of[0], **options)(fields)
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, inner, atol=1e-5 * np.abs(inner).max())


@pytest.mark.parametrize("seed", range(8))
def test_bodies_at_random_go_by_rows(seed):
    body = random_body(seed)
    flat = np.random.default_rng(seed).normal(size=(body.points.x.size, 2))
    expected = body.L @ flat
    np.testing.assert_allclose(body.in_turn(flat), expected, atol=1e-13 * np.abs(expected).max())


@pytest.mark.parametrize("base", ["elements", "bonds"])
@pytest.mark.parametrize("broken", [None, [[3030, 3031], [4555, 4655]]])
def test_an_uneven_sheet_has_the_same_bits_on_any_threads(base, broken):
    law, points = solid(2, base), wp.Points.sheet((90, 100), SPACING)
    rng = np.random.default_rng(0)
    u = rng.normal(size=points.x.shape)
    maps = {name: rng.uniform(0, 2, len(points.x)) for name in law.parts.names}
    before, found = threads(), []
    try:
        for count in (1, 3):
            set_threads(count)
            found.append(law.on(points, maps=maps, broken=broken, edges=True)(u))
    finally:
        set_threads(before)
    np.testing.assert_array_equal(*found)


def test_maps_reach_further_than_an_even_sheet_of_equal_lame_constants():
    """λ = μ: no even bond feels a dilatation, but with κ and μ of their own they do."""
    C = np.array([[3.0, 1, 0], [1, 3, 0], [0, 0, 1]])
    law = replace(solid(2, "bonds"), elastic=C)
    rng = np.random.default_rng(0)
    near, far = (lattice(2, 6, collar, SPACING) for collar in (3, 4))
    law.on(near)
    maps = {name: rng.uniform(0, 2, len(far.x)) for name in law.parts.names}
    with pytest.raises(InputError, match="have cut bonds; give a collar 7.3"):
        law.on(near, maps={"bulk": maps["bulk"][: len(near.x)]})
    u = rng.normal(size=far.x.shape)
    body = law.on(far, maps=maps)
    whole = law.on(far, edges=True, maps=maps)(u)
    np.testing.assert_allclose(body(u), whole, atol=1e-13 * np.abs(whole).max())


def test_cracks_grow_in_the_base_and_the_atoms_show_them():
    """The ledger of the base is the energy of the dressed body, event after event."""
    law = solid(2, "bonds", 2.0, 0.02)
    points = nodes(2, 13, interior=lambda x: np.abs(x[:, 1] - 6 * SPACING) < 5.5 * SPACING)
    x = points.x - 6 * SPACING
    pulled = wp.Cracked(points, u=x * [0, 1], cracks=[[(4 * SPACING, 6.5 * SPACING),
                                                      (8 * SPACING, 6.5 * SPACING)]])  # fmt: skip
    energies, lost = [], []
    for events in (2, 5):
        growth = wp.move(law.plain, pulled, events=events + 1)
        growth_before = wp.move(law.plain, pulled, events=events)
        pairs = grown(points, growth_before)
        body = law.on(points, edges=True, broken=pairs)
        plain = replace(law, tensors=0 * law.tensors).on(points, edges=True, broken=pairs)
        asked = wp.Dirichlet(points, 0 * x, x * [0, 1])
        u, v = (wp.solve(one, asked).u for one in (body, plain))
        np.testing.assert_allclose(body.displacement(v), u, atol=1e-10)
        np.testing.assert_allclose(v, growth.u / growth.time[-1], atol=1e-8)
        ledger = growth["energy"][-1]
        assert body.energy(u) == pytest.approx(ledger, rel=1e-9)
        energies.append(ledger)
        lost.append(len(pairs))
    assert energies[1] < energies[0]
    assert lost[1] > lost[0] > 10
    with pytest.raises(InputError, match="expected slow growth"):
        grown(nodes(2, 4), growth)
