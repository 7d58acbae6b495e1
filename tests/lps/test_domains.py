"""The proven bound on domains of any shape: Λmin(L) ≥ c λ₁ on fifty random ones."""

from functools import cache

import numpy as np
import pytest

from tests.lps.test_certificate import five_point
from tests.support.problems import lattice
from warp_peri import Model, certify
from warp_peri.materials.lps_matrices import matrices

DOMAINS = 50
HORIZON = 3.0


def random_domain(random):
    """A square, a disk, an L or a frame with a hole, of random size."""
    size = int(random.integers(4, 9))
    mask = np.ones((size, int(random.integers(4, 9))), bool)
    kind = random.choice(["square", "disk", "ell", "hole"])
    a, b = np.indices(mask.shape)
    if kind == "disk":
        centre = (np.array(mask.shape) - 1) / 2
        mask &= np.hypot(a - centre[0], b - centre[1]) <= size / 2
    elif kind == "ell":
        mask[mask.shape[0] // 2 :, mask.shape[1] // 2 :] = False
    elif kind == "hole":
        i, j = (int(random.integers(1, n - 2)) for n in mask.shape)
        mask[i : i + 2, j : j + 2] = False
    return mask


@cache
def random_model(seed):
    """A sign-changing kernel that the certificate holds for."""
    random = np.random.default_rng(seed)
    while True:
        mu = random.uniform(0.3, 1.0)
        model = Model(
            random.uniform(-0.9 * mu, 3 * mu), mu, random.uniform(-1, 2.9),
            random.normal(0.3, 0.6, size=5), HORIZON,
        )  # fmt: skip
        certificate = certify(model, spacing=1.0)
        if certificate.holds and model.influence(np.linspace(1, HORIZON, 20)).min() < 0:
            return model, certificate


@pytest.mark.parametrize("seed", range(DOMAINS))
def test_smallest_eigenvalue_is_at_least_the_proven_share_of_the_laplacians(seed):
    random = np.random.default_rng(seed)
    model, certificate = random_model(seed % 5)
    domain = random_domain(random)
    points = lattice(domain, HORIZON)
    unknown = np.repeat(points.interior, 2)
    L = matrices(model, points).operator(model.lam, model.mu)[:, unknown].toarray()
    smallest = np.linalg.eigvalsh((L + L.T) / 2)[0]
    laplacian = np.linalg.eigvalsh(five_point(domain))[0]
    assert smallest >= certificate.symbol_bound * laplacian
    assert certificate.symbol_bound > 0.9 * certificate.symbol_min
