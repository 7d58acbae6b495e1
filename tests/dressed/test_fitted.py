"""Elements that an outline cuts, grains, and bodies solved by iterations."""

from dataclasses import replace

import numpy as np
import pytest

import warp_peri as wp
from tests.dressed.solids import SPACING, nodes, rigid, solid
from tests.dressed.test_body import check
from warp_peri.core.elastic import turned, voigt
from warp_peri.errors import InputError
from warp_peri.statics.solution import Direct, Krylov


@pytest.mark.parametrize(("d", "fine", "kept"), [(2, 20, 0.65), (3, 8, 0.625)])
def test_cut_elements_store_what_their_part_inside_does(d, fine, kept):
    """Of u = x y along the last axis, against the integral over the positions that lie inside."""
    law = solid(d)
    law = replace(law, tensors=0 * law.tensors)
    points = nodes(d, 2)
    body = law.on(points, edges=lambda x: x[:, 0] < kept * SPACING)
    x = points.x / SPACING
    u = np.zeros_like(points.x)
    u[:, -1] = x[:, 0] * x[:, 1]
    assert body.share[0] == pytest.approx(kept)
    line = (np.arange(fine) + 0.5) / fine
    a, b = (m.ravel() for m in np.meshgrid(line[line < kept], line, indexing="ij"))
    e = np.zeros((len(a), {2: 3, 3: 6}[d]))
    e[:, 1 if d == 2 else 3], e[:, 2 if d == 2 else 4] = a, b  # ∂₂u and ∂₁u
    energy = np.einsum("ni,ij,nj->", e, voigt(law.tensor()), e) / fine**2 / 2
    assert body.energy(u) == pytest.approx(energy * SPACING ** (d - 2), rel=1e-9)


def turned_law(law, angle):
    """The same crystal on nodes turned against it, under a random G of its own."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s], [s, c]])
    other = np.einsum("ia,nab,jb->nij", R, law.tensors[0], R)[None]
    return replace(law, elastic=voigt(turned(law.tensor(), R)), tensors=other, symmetry="")


def test_grains_resist_no_turn_and_are_their_own_laws():
    law = solid(size=0.04)
    laws = [law, turned_law(law, 0.4), turned_law(law, 1.0)]
    points = nodes(2, 12)
    rng = np.random.default_rng(0)
    number = rng.integers(0, 3, len(points.x))
    maps = {name: rng.random(len(points.x)) for name in law.parts.names}
    assert check(law.on(points, edges=True, grains=(laws, number), maps=maps))
    u = rng.normal(size=points.x.shape)
    for n, one in enumerate(laws):
        alone = law.on(points, edges=True, grains=(laws, np.full(len(u), n)))
        np.testing.assert_allclose(alone(u), one.on(points, edges=True)(u), atol=1e-12)
    halves = (points.x[:, 0] > points.x[:, 0].mean()).astype(int)
    body = law.on(points, edges=True, grains=(laws, halves))
    far = np.abs(points.x[:, 0] - points.x[:, 0].mean()) > 4 * SPACING
    own = np.where(
        halves[:, None] == 1, laws[1].on(points, edges=True)(u), law.on(points, edges=True)(u)
    )
    np.testing.assert_allclose(body(u)[far], own[far], atol=1e-12)
    for given, why in (
        (number, "expected a pair"),
        ((laws, number[:5]), "expected 144 whole numbers"),
        ((laws[:2], number), "expected numbers of 2 models, got 0 to 2"),
        (([law, solid(reach=1.0)], halves), "one base, spacing, units and neighbours"),
    ):
        with pytest.raises(InputError, match=why):
            law.on(points, edges=True, grains=given)


@pytest.mark.parametrize("d", [2, 3])
def test_iterations_find_what_a_factorisation_does(d):
    """A free body with an outline, and one that is held, and nodes that nothing belongs to."""
    law = solid(d, split=True)
    n = {2: 16, 3: 9}[d]
    everywhere = nodes(d, n)
    middle = everywhere.x.mean(axis=0)

    def inside(x):
        return np.linalg.norm(x - middle, axis=1) < (n / 2 - 1.6) * SPACING

    rng = np.random.default_rng(0)
    for points in (everywhere, nodes(d, n, interior=lambda x: x[:, 0] > 0.4 * n * SPACING)):
        body = law.on(points, edges=inside)
        b = rng.normal(size=points.x.shape) * body.stiffness.any(axis=1)[:, None]
        motions = rigid(points).reshape(-1, b.size) * body.stiffness.ravel().astype(bool)
        motions = np.linalg.qr(motions.T)[0]
        b = (b.ravel() - motions @ (motions.T @ b.ravel())).reshape(
            b.shape
        ) * body.stiffness.astype(bool)
        direct = wp.solve(body, wp.Dirichlet(points, b, 0 * b), solver=Direct())
        found = wp.solve(body, wp.Dirichlet(points, b, 0 * b), solver=Krylov(tolerance=1e-10))
        assert found.method == "cg"
        assert found.residual < 1e-9
        np.testing.assert_allclose(found.u, direct.u, atol=1e-6 * np.abs(direct.u).max())
    free = law.on(everywhere, edges=lambda x: np.abs(x[:, 0] - middle[0]) > SPACING)
    apart = np.sign(everywhere.x - middle) * [1.0, *[0.0] * (d - 1)]
    apart = apart * (np.abs(everywhere.x - middle)[:, :1] > 3.25 * SPACING)
    for solver in (Direct(), Krylov()):
        with pytest.raises(InputError, match="falls apart"):
            wp.solve(free, wp.Dirichlet(everywhere, apart, 0 * apart), solver=solver)
    loose = np.ones_like(b)
    with pytest.raises(InputError, match="no load on nodes that nothing belongs to"):
        wp.solve(body, wp.Dirichlet(points, loose, 0 * b))
