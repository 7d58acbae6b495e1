"""What every law refuses of the fields it is given, and the smallest problem it answers."""

from dataclasses import replace

import numpy as np
import pytest

import warp_peri as wp
from tests.conformance.test_laws import LAWS
from tests.support.problems import lattice
from warp_peri.points.arrays import checked_fields
from warp_peri.points.outlines import box as outline
from warp_peri.points.outlines import mesh_outline

pytestmark = pytest.mark.filterwarnings("ignore:strain:UserWarning")


def wrong(zero, inside):
    """Fields that are none, by what must be said of them."""
    hidden = np.ma.masked_array(zero, np.ones(zero.shape, bool))
    return (
        (zero[:2], "expected shape"),
        (zero[inside], "expected shape"),
        (np.zeros((2, 2, *zero.shape)), "expected shape"),
        (zero * 1j, "expected float values, got complex128"),
        (hidden, "masked"),
        (zero.astype(str), "expected float values"),
        ([[1.0, 2.0], [3.0]], "expected an array"),
        (zero + np.nan, "expected finite values"),
    )


@pytest.mark.parametrize("name", LAWS)
def test_fields_that_are_none_are_refused_in_words(name):
    points = LAWS[name].points(5)
    operator, zero = LAWS[name].material().on(points), np.zeros(points.x.shape)
    for bad, words in wrong(zero, points.interior):
        for b, u, which in ((bad, zero, "b"), (zero, bad, "u")):
            with pytest.raises(wp.InputError, match=f"{which}: .*{words}"):
                wp.solve(operator, wp.Dirichlet(points, b, u))
    for b in (np.zeros((3, *zero.shape)), np.zeros(2)):
        with pytest.raises(wp.InputError, match="b: expected shape"):
            wp.solve(operator, wp.Dirichlet(points, b, zero))


@pytest.mark.parametrize("name", LAWS)
def test_an_operator_itself_reads_no_half_of_a_field(name):
    points = LAWS[name].points(4)
    op, zero = LAWS[name].material().on(points), np.zeros(points.x.shape)
    hidden = np.ma.masked_array(zero, np.zeros(zero.shape, bool))
    hidden[np.flatnonzero(points.interior)[0]] = np.ma.masked
    reads = (
        op,
        op.rhs,
        op.stress,
        op.energy,
        lambda bad: op.jvp(zero, bad),
        lambda bad: op.vjp(zero, bad[points.interior]),
    )
    for bad in (hidden, zero * 1j, zero.astype(str), zero.astype(object)):
        for read in reads:
            if read != op.energy or op.energy(zero) is not None:
                with pytest.raises(wp.InputError, match="expected (float )?values"):
                    read(bad)


@pytest.mark.parametrize("name", [name for name in LAWS if LAWS[name].sheet])
def test_loads_of_a_period_that_are_none_are_refused_in_words(name):
    points, material = LAWS[name].sheet(), LAWS[name].material()
    if not hasattr(material.on(points), "solve_periodic"):
        pytest.skip("it solves no periodic problems")
    for bad, words in wrong(np.zeros(points.x.shape), points.interior)[3:]:
        with pytest.raises(wp.InputError, match=f"b: .*{words}"):
            wp.solve(material, wp.Periodic(points, bad))


@pytest.mark.parametrize("name", LAWS)
def test_one_unknown_node_is_solved_for_whatever_is_not_read(name):
    points = LAWS[name].points(5)
    one = replace(points, interior=np.arange(len(points.x)) == len(points.x) // 2)
    read = np.repeat(one.interior[:, None], points.x.shape[1], axis=1)
    b, u = np.where(read, 1e-3, np.nan), np.where(read, np.nan, 0.0)
    solution = wp.solve(LAWS[name].material(), wp.Dirichlet(one, b, u))
    assert np.isfinite(solution.u).all()
    assert solution.residual < 1e-6


def test_what_is_not_read_may_be_anything():
    points = lattice(3, 2.0)
    inside = points.interior[:, None]
    b = np.ma.masked_array(np.ones(points.x.shape), np.broadcast_to(~inside, points.x.shape))
    load, u = checked_fields(points, b, np.where(inside, np.nan, 0 * points.x + 2))
    assert (load[points.interior] == 1).all()
    assert (u[~points.interior] == 2).all()
    for samples in (0, 2):
        fields = np.zeros((samples, *points.x.shape))
        assert len(checked_fields(points, fields, fields)[0]) == samples
    with pytest.raises(wp.InputError, match="u: expected shape"):
        checked_fields(points, None, np.zeros((1, 1, *points.x.shape)))


PLATE = mesh_outline(outline(60, 60), size=6)


def plate(displacement=(0, 0), traction=(5e-3, 0), **given):
    return wp.Body(PLATE, {"left": displacement}, {"right": traction}, **given)


def test_vectors_of_a_body_that_are_none_are_refused_in_words():
    model = wp.LPSMaterial(0.5, 1.0, 1.0, [1.0], horizon=3.0)
    hidden = np.ma.masked_array([1.0, 0.0], [True, False])
    functions = (lambda x: 1j * x, lambda x, n: 1j * n)
    for bad in ((1j, 0), ("0", "0"), hidden, [[1.0], [2.0, 3.0]], (np.inf, 0)):
        with pytest.raises(wp.InputError, match="part 'left': expected"):
            wp.solve(model, plate(bad))
        with pytest.raises(wp.InputError, match="part 'right': expected"):
            wp.solve(model, plate(traction=bad))
    with pytest.raises(wp.InputError, match="part 'left': expected float values"):
        wp.solve(model, plate(functions[0]))
    with pytest.raises(wp.InputError, match="part 'right': expected float values"):
        wp.solve(model, plate(traction=functions[1]))
    with pytest.raises(wp.InputError, match="part 'left': expected it held or pulled, got both"):
        wp.solve(model, wp.Body(PLATE, {"left": (0, 0)}, {"left": (5e-3, 0)}))
    half = wp.Body(PLATE, {"left": (0, np.nan), "right": (0, 0)}, {"left": (5e-3, 0)})
    assert wp.solve(model, half).residual < 1e-8
    with pytest.raises(wp.InputError, match="displacement: expected values by"):
        wp.solve(model, wp.Body(PLATE, None))


def test_a_plain_model_is_proven_where_a_body_needs_it():
    model = wp.LPSMaterial(0.5, 1.0, 1.0, [1.0], horizon=3.0)
    by_default = wp.solve(model, plate())
    told = wp.solve(replace(model, certified_on=(1.0,)), plate())
    np.testing.assert_array_equal(by_default.u, told.u)
    coupling = wp.methods.Coupling(spacing=1.0)
    details = wp.solve(model, plate(coupling=coupling)).details
    assert details.model.certified_on == (1.0,)
    assert details.model.certificate["1"]["symbol_bound"] > 0
    with pytest.raises(wp.InputError, match="model: nothing is proven of it on 1 Å"):
        wp.solve(wp.LPSMaterial(0.3, 0.8, 1.0, [1.0, -0.9, 0.3], horizon=3.0), plate())
