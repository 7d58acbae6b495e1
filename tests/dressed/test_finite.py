"""Finite strain: learning, the proof, refusals. What every law must do is in tests/conformance."""

from dataclasses import replace

import numpy as np
import pytest

import warp_peri as wp
from tests.support.problems import AXIS, lattice
from tests.support.sheets import waves
from warp_peri.dressed import FiniteSolid, FiniteStrain
from warp_peri.errors import InputError
from warp_peri.statics.solution import Newton

CONSTANTS = (-0.5, -6.8, 1.04)
ELASTIC = [[1.24, -0.2, 0], [-0.2, 1.24, 0], [0, 0, 0.72]]


def solid(along=-0.12, across=0.03, share=0.05):
    return FiniteSolid(1.0, -0.2, 0.72, along, across, share, *CONSTANTS)


def test_a_law_is_found_again_from_its_forces():
    law, points = solid(), lattice(6, 1.5)
    u = np.stack([waves(points, 0.02, seed) for seed in range(4)])
    b = np.zeros_like(u)
    b[:, points.interior] = law.on(points)(u)
    samples = wp.Samples(points, u, b)
    fit = wp.fit(samples, FiniteStrain(ELASTIC))
    found = fit.material
    for name in ("along", "across", "share", "t3", "tq2", "q3"):
        assert getattr(found, name) == pytest.approx(getattr(law, name), rel=1e-4), name
    assert fit.history["E_res"] < 1e-6
    with pytest.raises(InputError, match="expected loads, got none on sample 0"):
        wp.fit(wp.Samples(points, u, 0 * b), FiniteStrain(ELASTIC))
    with pytest.raises(InputError, match="isotropic sheet"):
        wp.fit(samples, FiniteStrain(np.diag([1.0, 2.0, 0.7])))


def test_the_tangent_is_positive_up_to_the_proven_strain():
    """Fields that reach it at their worst node, and rougher ones; far beyond it is not."""
    law, points = solid(), lattice(7, 1.5)
    body, rng = law.on(points), np.random.default_rng(0)
    inside = np.repeat(points.interior, 2)
    assert 0.02 < law.strain < 0.05
    least = []
    for trial in range(12):
        u = waves(points, 0.05, trial) if trial % 2 else rng.normal(size=points.x.shape)
        u *= law.strain / body.largest_gradient(u)
        assert body.largest_gradient(u) == pytest.approx(law.strain)
        K = body.tangent(u).toarray()[:, inside]
        np.testing.assert_allclose(K, K.T, atol=1e-13)
        least.append(np.linalg.eigvalsh(K)[0])
    assert min(least) > 0
    stretched = body.tangent(0.3 * points.x).toarray()[:, inside]
    assert np.linalg.eigvalsh(stretched)[0] < 0


def test_more_cubic_or_a_rougher_cubic_part_proves_less():
    law = solid()
    assert solid(share=-0.2).strain < law.strain  # F makes short waves larger than G does
    assert replace(law, tq2=-13.6).strain < 0.7 * law.strain
    assert solid(along=0.3).strain == 0.0  # G without an inverse
    assert solid().proven_strain(2.0) == 0.0
    still = replace(law, t3=0.0, tq2=0.0, q3=0.0)
    assert still.strain > 3 * law.strain
    assert "one solution up to" in repr(law)


def test_loads_beyond_the_proof_are_answered_with_a_warning():
    law, points = solid(), lattice(6, 1.5)
    body = law.on(points)
    u = 1.5 * waves(points, 0.05, 3)
    b = np.zeros_like(u)
    b[points.interior] = body(u)
    with pytest.warns(UserWarning, match="proven unique up to"):
        answer = wp.solve(body, wp.Dirichlet(points, b, u), solver=Newton(eigenvalues=True))
    np.testing.assert_allclose(answer.u, u, atol=1e-7)
    assert answer.proven is None
    assert answer.details[0].eigenvalue > 0
    small = wp.solve(body, wp.Dirichlet(points, 0.05 * b, 0.05 * u))
    assert "no other solution" in small.proven
    with pytest.raises(InputError, match="no equilibrium was found"):
        wp.solve(body, wp.Dirichlet(points, 1e5 * b, 0 * u))


def test_what_does_not_fit_is_refused():
    law, points = solid(), lattice(3, 1.5)
    with pytest.raises(InputError, match="a collar of three spacings"):
        law.on(wp.Points(points.x, np.ones(len(points.x), bool), 1.0, axis=np.rad2deg(AXIS)))
    with pytest.raises(InputError, match="spacing: the model is for 1"):
        law.on(wp.Points(2 * points.x, points.interior, 2.0))
    with pytest.raises(InputError, match="λ \\+ μ > 0"):
        replace(law, mu=0.1)
    with pytest.raises(InputError, match="t3: expected a finite number"):
        replace(law, t3=np.nan)
    sheet = wp.Points.sheet((8, 8), 1.0)
    with pytest.raises(InputError, match="nodes that are held: no periodic problem is solved"):
        wp.solve(law, wp.Dirichlet(sheet, 0 * sheet.x, 0 * sheet.x))
