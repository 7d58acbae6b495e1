"""Up to which gradient a third-order crystal has one solution, proven (theory.md, N25–N27)."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from warp_peri.micromodulus.certificate import DEEPEST, FIRST, MOST_CELLS, parts
from warp_peri.micromodulus.family import bend
from warp_peri.micromodulus.groups import canonical
from warp_peri.micromodulus.law import Crystal
from warp_peri.micromodulus.regression import zone_sample
from warp_peri.micromodulus.third_order import ThirdOrderCrystal
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.stability.uniqueness import SLACKS, Uniqueness, uniqueness_of

SAMPLE = 160
"""Intervals of the grid that κ is sampled on."""
ROUNDING = 1e-13


def uniqueness(model: ThirdOrderCrystal) -> Uniqueness:
    """Prove up to which |H| solutions on the law's own lattice are unique.

    Nothing is proven of tensors without a certificate.
    """
    classes = bond_classes(model.spacing, model.reach)
    p_in, p_out = model.weights(classes)
    kappa_out = proven_kappa(model.linear, classes, p_out)
    kappa_in = kappa_out if p_in is p_out else proven_kappa(model.linear, classes, p_in)
    return uniqueness_of(model, model.spacing, kappa_in, kappa_out)


def proven_crystal(model: ThirdOrderCrystal) -> ThirdOrderCrystal:
    """The law with its guarantee, where the tensors are certified."""
    proof = model.linear.certificate
    if proof is None or not proof.holds:
        return model
    return replace(model, proven=uniqueness(model).figures())


def proven_kappa(law: Crystal, classes: BondClasses, p: np.ndarray) -> float:
    """A proven upper bound of κ_p of (N14) [stress^(−1/2)]; infinite when none was found.

    Args:
        law: certified tensors.
        classes: bond classes of the gradient's family.
        p: its weights by class [1/length²], Σ n r² p = 1.
    """
    pull = _Gradient(classes, p, law.spacing)
    tensors = law.tensors * law.spacing**2
    phase = zone_sample(law.group, 2, SAMPLE)
    stiff = np.linalg.eigvalsh(np.tensordot(bend(phase, law.steps), tensors, 1))[:, 0]
    proof = law.certificate
    if proof is None or not (stiff.min() > 0 and proof.long_waves > 0):
        return float(np.inf)
    sampled = float((pull.square(phase)[0] / stiff).max())
    for slack in SLACKS:
        if _holds(law, tensors, pull, 1 / (slack * sampled), proof.long_waves):
            return float(np.sqrt(slack * sampled))
    return float(np.inf)


class _Gradient:
    """|h_p(k)|² h² of the gradient with weights p, at phases k h."""

    def __init__(self, classes: BondClasses, p: np.ndarray, spacing: float) -> None:
        self.steps = classes.xi / spacing
        self.weight = (p * spacing**2)[classes.bond_class]
        length = np.linalg.norm(self.steps, axis=1)
        size = np.abs(self.weight)
        self.moment = [float(size @ length**n) for n in range(5)]

    def square(self, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Its values, shape [K], and slopes, shape [2, K]."""
        x, angle = self.steps, phase @ self.steps.T
        h = 2 * np.sin(angle) @ (self.weight[:, None] * x)
        cosine = 2 * np.cos(angle) * self.weight
        slope = np.stack([((cosine * x[:, a]) @ x * h).sum(axis=1) for a in range(2)])
        return (h**2).sum(axis=1), 2 * slope

    @property
    def curvature(self) -> float:
        """Of the square along any line, at most (N18)."""
        return 2 * (4 * self.moment[1] * self.moment[3] + self.moment[2] ** 2)


def _holds(law: Crystal, tensors: np.ndarray, pull: _Gradient, c: float, long: float) -> bool:
    """Whether D(k) ≥ c |h_p(k)|² is proven for all k.

    Near k = 0 by (N26), elsewhere on cells by (N27), halved where they fail.
    """
    steps, x = law.steps, law.steps.astype(float)
    above, below = parts(tensors)
    radius = _long_wave_radius(x, above, pull, c, long)
    if radius == 0:
        return False
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=2)))
    bent = [np.tensordot((x @ corner) ** 2, above + below, 1) for corner in corners]
    curved = max(float(np.linalg.eigvalsh(B)[-1]) for B in bent) + c * pull.curvature
    size = float(np.linalg.eigvalsh(above + below)[:, -1].sum())
    slack = ROUNDING * (4 * size + 4 * c * pull.moment[1] ** 2)
    half, seen = np.pi / FIRST, 0
    line = np.arange(-np.pi + half, np.pi, 2 * half)
    cells = np.array(list(itertools.product(line, repeat=2)))
    for _ in range(DEEPEST):
        cells = cells[canonical(cells, law.group, half)]
        cells = cells[((np.abs(cells) + half) ** 2).sum(axis=1) > radius**2]
        seen += len(cells)
        if not len(cells):
            return True
        if seen > MOST_CELLS[2]:
            return False
        base, slopes = _affine(steps, tensors, pull, c, cells)
        low = np.full(len(cells), np.inf)
        for corner in half * corners:
            at = base + np.tensordot(corner, slopes, 1)
            low = np.minimum(low, np.linalg.eigvalsh(at)[:, 0])
        left = cells[low - curved * half**2 - slack <= 0]
        half /= 2
        cells = (left[:, None, :] + half * corners).reshape(-1, 2)
    return False


def _affine(
    steps: np.ndarray, tensors: np.ndarray, pull: _Gradient, c: float, cells: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """D − c |h_p|² at the middles of cells, [K, 2, 2], and its slopes, [2, K, 2, 2]."""
    value, slope = pull.square(cells)
    sine = 2 * np.sin(cells @ steps.T)
    base = np.tensordot(bend(cells, steps), tensors, 1)
    slopes = np.stack([np.tensordot(sine * steps[:, a], tensors, 1) for a in range(2)])
    one = np.eye(2)
    return base - c * value[:, None, None] * one, slopes - c * slope[..., None, None] * one


def _long_wave_radius(
    x: np.ndarray, above: np.ndarray, pull: _Gradient, c: float, long: float
) -> float:
    """|k| h inside which D ≥ c |h_p|² by (N26), from D ≥ long |k|² − …; 0 if nowhere."""
    quartic = np.tensordot((x**2).sum(axis=1) ** 2, above, 1) / 12
    fourth = float(np.linalg.eigvalsh(quartic)[-1])
    third = pull.moment[4] / 3
    # long − fourth g − c (1 + third g)² ≥ 0, g = |k h|²
    if not long > c:
        return 0.0
    b = fourth + 2 * c * third
    root = (-b + np.sqrt(b**2 + 4 * c * third**2 * (long - c))) / (2 * c * third**2)
    return float(0.999 * np.sqrt(root))
