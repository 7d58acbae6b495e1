"""A law of your own, springs between nodes, on one process or on two: mpiexec -n 2 python …"""

from argparse import ArgumentParser
from dataclasses import dataclass
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Annotated

import numpy as np

import warp_peri as wp
from warp_peri.core.record import FieldUnits, Length
from warp_peri.core.stencil import Stencil, half_ball
from warp_peri.crystals import StencilMaterial
from warp_peri.mpi import gather, is_root, partition


@dataclass(frozen=True, eq=False, repr=False)
class Springs(StencilMaterial, format="own.springs"):
    """A spring along each bond ξ up to the horizon: C(ξ) = Σ_n c_n (h/r)^n ξξᵗ/(r h)², r = |ξ|."""

    spacing: Length
    horizon: Length
    c: Annotated[np.ndarray, FieldUnits(stress=1)]
    units: tuple[str, str] = ("angstrom", "TPa")
    certificate: wp.certificates.StencilCertificate | None = None

    @property
    def stencil(self) -> Stencil:
        steps = half_ball(self.horizon / self.spacing, 2)
        r = np.linalg.norm(steps, axis=1, keepdims=True)
        stiff, e = r ** -np.arange(len(self.c)) @ self.c / self.spacing**2, steps / r
        return Stencil(self.spacing, steps, np.einsum("n,ni,nj->nij", stiff, e, e))


class SpringLaw:
    def learn(self, samples: wp.Samples, *, horizon: float) -> SimpleNamespace:
        """Three numbers c by least squares of L u = b."""
        parts = [Springs(samples.spacing, horizon, c).on(samples.points) for c in np.eye(3)]
        L = np.stack([part(samples.u).ravel() for part in parts], axis=1)
        c = np.linalg.lstsq(L, samples.loads[:, samples.interior].ravel())[0]
        return SimpleNamespace(material=Springs(samples.spacing, horizon, c).certified())


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    x = 5.0 * (np.argwhere(np.ones((33, 33))) - 16)
    points = wp.Points(x, np.abs(x).max(axis=1) < 55, spacing=5.0)
    k, phase = np.array([[0.05, 0.02], [-0.03, 0.08], [0.11, 0.06]]), np.arange(3)[:, None]
    u = np.stack([np.sin(k @ x.T + phase), np.cos(k @ x.T - phase)], axis=2)
    b = np.zeros_like(u)
    other = wp.LPSMaterial(0.5, 0.5, 1.0, np.ones(1), horizon=12.5, certified_on=(5.0,))
    b[:, points.interior] = other.on(points)(u)
    train, test = wp.Samples(points, u[:2], b[:2]), wp.Samples(points, u[2:], b[2:])
    with TemporaryDirectory() as folder:
        wp.save(f"{folder}/springs.json", wp.fit(train, SpringLaw(), horizon=12.5).material)
        law = wp.load(f"{folder}/springs.json")  # which goes through its proof again
    piece = partition(points)  # the points themselves, or those of this process
    own = getattr(piece, "number", slice(None))
    rest = wp.solve(law, wp.Dirichlet(piece, b[2, own], u[2, own]))
    swing = wp.simulate(
        law, wp.Dirichlet(piece, None, rest.u), density=2200.0, step=0.025, steps=50
    )
    size = [np.linalg.norm(gather(piece, field)) for field in (rest.u, swing.u)]
    if is_root():
        print(wp.evaluate(law, test)["E_u"], wp.certify(law).symbol_bound, *size)
