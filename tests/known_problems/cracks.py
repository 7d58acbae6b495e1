"""Cracks at rest: their stress intensities, by energies of cracks of several lengths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from examples.exact import westergaard
from tests.known_problems.statics import LEARNED, Outcome, UnitScale, material, plane, solid
from warp_peri.fracture.body import box_nodes, penny_corners, point_force, rectangle_nodes
from warp_peri.fracture.bonds import unit_toughness
from warp_peri.fracture.problems import Cracked, energy_release, tip_shift
from warp_peri.fracture.statics import apparent_toughness, cut_by_spacing, spent
from warp_peri.points.families import bond_classes
from warp_peri.points.points import Points
from warp_peri.solvers.solution import CG

NU = {"LPS": 0.3, "bond-based": 1 / 3, LEARNED: 0.3}
HALF = 13
"""Spacings of a crack, and of its ligament; a spacing is a metre."""
LONG = 32
"""Spacings of a crack that is held against a calibrated stretch: what it spends depends on it."""
LENGTHS = range(-2, 3)
"""Of a crack whose energies are compared, in spacings beyond its own."""


@cache
def shift_of(name: str) -> float:
    """The shift of a tip [m], in a metre's lattice."""
    law = material(name, plane(1000.0, NU[name]).tensor, 1.0, UnitScale())
    return tip_shift(law, 1.0, corrected=True)


def intensity(
    name: str, s: UnitScale, x: np.ndarray, stress: np.ndarray, tips: Sequence[Sequence[Any]]
) -> float:
    """K [MPa √m] of free nodes x [m], a metre apart, under a balanced load `stress` [MPa/m].

    `tips` are sets of polylines [m] by LENGTHS.
    """
    law = material(name, plane(1000.0, NU[name]).tensor, 1.0, s)
    points = Points(s.length * x, np.ones(len(x), bool), s.length, units=s.units)
    free, low = np.ones(x.shape, bool), np.argsort(np.abs(x - [0, x[:, 1].min()]).sum(axis=1))
    free[low[0]] = free[low[1], 1] = False
    cracks = [[s.length * np.asarray(line, float) for line in one] for one in tips]
    load, here = s.stiffness / s.length * stress, cracks[LENGTHS.index(0)]
    problem = Cracked(points, load, cracks=here, free=free, corrected=True)
    G = energy_release(law, problem, cracks, shift=s.length * shift_of(name))
    return float(np.sqrt(G / s.length * law.E) / s.stiffness)


def ends(x: np.ndarray) -> np.ndarray:
    """A unit tension on the first and the last row."""
    top = np.abs(x[:, 1]) == x[:, 1].max()
    return np.where(top, np.sign(x[:, 1]), 0.0)[:, None] * [0.0, 1.0]


def centre_crack(name: str, s: UnitScale) -> Outcome:
    """K over σ√(πa) of a crack over half of a strip."""
    a, x = HALF, rectangle_nodes(4.0 * HALF, 8.0 * HALF, 1.0)
    tips = [[[(-a - d, 0), (a + d, 0)]] for d in LENGTHS]
    K = intensity(name, s, x, ends(x), tips)
    return Outcome(K / np.sqrt(np.pi * a))


def edge_crack(name: str, s: UnitScale, *, double: bool = False) -> Outcome:
    """K over σ√(πa) of a crack from an edge to the middle of a strip, or of one from each."""
    a, width = HALF, 2 * HALF * (1 + double)
    x, w = rectangle_nodes(width, (6.0 + 2 * double) * HALF, 1.0), width / 2
    tips = [[[(-w - 1, 0), (a + d - w, 0)]] for d in LENGTHS]
    for d, one in zip(LENGTHS, tips):
        one += [[(w - a - d, 0), (w + 1, 0)]] if double else []
    K = intensity(name, s, x, ends(x), tips)
    return Outcome(K / np.sqrt(np.pi * a))


def bend_bar(name: str, s: UnitScale) -> Outcome:
    """f of the bend bar of ASTM E399, K = P S / (B W^1.5) f, at a/W = 1/2 and S = 4 W."""
    a, W = HALF, 2 * HALF
    x, b = rectangle_nodes(4.0 * W + 8, W, 1.0), np.zeros(((4 * W + 8) * W, 2))
    for place, side, force in ((0, 1, -1.0), (-2 * W, -1, 0.5), (2 * W, -1, 0.5)):
        b += point_force(x, 1.0, (place, side * W / 2), (0.0, force))
    tips = [[[(0, -W), (0, a + d - W / 2)]] for d in LENGTHS]
    K = intensity(name, s, x, b, tips)
    return Outcome(K * W**1.5 / (4 * W))


def compact_tension(name: str, s: UnitScale) -> Outcome:
    """f of the compact tension of ASTM E399, K = P / (B √W) f, at a/W = 1/2, on 20 spacings."""
    W = 40.0
    x = rectangle_nodes(1.25 * W, 1.2 * W, 1.0) + np.array([0.375 * W, 0.0])
    x = x[np.hypot(x[:, 0], np.abs(x[:, 1]) - 0.275 * W) > 0.125 * W]
    rim = np.hypot(x[:, 0], np.abs(x[:, 1]) - 0.275 * W) < 0.125 * W + 1
    pushed = rim & (np.abs(x[:, 1]) > 0.275 * W + 0.09 * W)
    b = np.where(pushed, np.sign(x[:, 1]) * 2 / pushed.sum(), 0.0)[:, None] * [0.0, 1.0]
    tips = [[[(-W, 0), (W / 2 + d, 0)]] for d in LENGTHS]
    K = intensity(name, s, x, b, tips)
    return Outcome(K * np.sqrt(W))


def brazilian_disc(name: str, s: UnitScale) -> Outcome:
    """K over P √a / (√π R B) of a slot over half of a disc that is pressed along it."""
    a, R = HALF, 2.0 * HALF
    x = rectangle_nodes(2 * R, 2 * R, 1.0)
    x = x[np.hypot(*x.T) <= R]
    b = point_force(x, 1.0, (0.0, R), (0.0, -1.0)) + point_force(x, 1.0, (0.0, -R), (0.0, 1.0))
    tips = [[[(0, -a - d), (0, a + d)]] for d in LENGTHS]
    K = intensity(name, s, x, b, tips)
    return Outcome(K * np.sqrt(np.pi / a) * R)


def slanted_crack(name: str, s: UnitScale, *, angle: bool = False) -> Outcome:
    """K over σ√(πa) of a crack at 45° to the tension, √(K_I² + K_II²); or the angle of its kink.

    The crack lies along rows of nodes, the field of an endless sheet is given around it.
    """
    a, law = HALF, material(name, plane(1000.0, NU[name]).tensor, 1.0, s)
    x = rectangle_nodes(4.0 * a + 12, 4.0 * a + 12, 1.0)
    inside = np.abs(x).max(axis=1) < 2 * a
    points = Points(s.length * x, inside, s.length, units=s.units)
    u = s.length * slanted(x, float(a), plane(1000.0, NU[name]))
    cracks = [[s.length * np.array([(-a - d, 0.0), (a + d, 0.0)])] for d in LENGTHS]
    problem = Cracked(points, u=u, cracks=cracks[LENGTHS.index(0)], corrected=True)
    if angle:
        found = problem.solved(law, None, {}).u / s.length
        below = np.flatnonzero((np.abs(x[:, 0]) < a) & (x[:, 1] == -0.5))
        jump = [found[x[:, 1] == 0.5][np.isin(x[x[:, 1] == 0.5, 0], x[below, 0])], found[below]]
        slide, opening = (jump[0] - jump[1]).sum(axis=0)
        ratio = opening / slide
        kink = 2 * np.arctan((ratio - np.sqrt(ratio**2 + 8)) / 4)
        return Outcome(float(np.degrees(kink)))
    G = energy_release(law, problem, cracks, shift=s.length * shift_of(name))
    return Outcome(float(np.sqrt(1000 * G / s.length / s.stiffness / (np.pi * a))))


def dugdale(name: str, s: UnitScale) -> Outcome:
    """Tension over the yield stress under which strips as long as a crack close its tips, K = 0.

    The strips |x| from a to c pull at the yield stress. That is tension less yield stress on an
    endless sheet with a crack to c, and yield stress on the faces to a; K of both adds up. Each is
    an energy release in a square whose sides have the field of the continuum.
    """
    a, c, moduli = HALF // 2, 2 * (HALF // 2), plane(1000.0, NU[name])
    law, x = material(name, moduli.tensor, 1.0, s), rectangle_nodes(4.0 * c + 12, 4.0 * c + 12, 1.0)
    points = Points(s.length * x, np.abs(x).max(axis=1) < 2 * c, s.length, units=s.units)
    cracks = [[s.length * np.array([(-c - d, 0.0), (c + d, 0.0)])] for d in LENGTHS]
    faces = np.where((np.abs(x) < (a, 1)).all(axis=1), np.sign(x[:, 1]), 0.0)[:, None] * [0.0, 1.0]
    far, inner = westergaard(x, c, 1.0, moduli.C12, moduli.C44), opened(x, a, c, moduli)
    K = list[float]()
    for u, b in ((far, 0 * faces), (inner, faces)):
        how: dict[str, Any] = {"cracks": cracks[LENGTHS.index(0)], "corrected": True}
        problem = Cracked(points, s.stiffness / s.length * b, s.length * u, **how)
        G = energy_release(law, problem, cracks, shift=s.length * shift_of(name))
        K.append(float(np.sqrt(G)))
    return Outcome(1 - K[1] / K[0])


def opened(x: np.ndarray, a: float, c: float, moduli: Any) -> np.ndarray:
    """u of a crack |x| < c with a unit pressure on its faces up to a < c, in an endless sheet.

    Westergaard's function of a pair of forces, integrated over |x| < a.
    """
    lam, mu = moduli.C12, moduli.C44
    kolosov, z, y = (lam + 3 * mu) / (lam + mu), x[:, 0] + 1j * x[:, 1], x[:, 1]
    root, q, share = np.sqrt(z - c) * np.sqrt(z + c), np.sqrt(c**2 - a**2), np.arcsin(a / c)
    turn = np.arctan(a * root / (z * q))
    Z = 2 / np.pi * (share * z / root - turn)
    integral = 2 / np.pi * (share * root - z * turn - a * np.arctan(q / root))
    u = (kolosov - 1) / 2 * integral.real - y * Z.imag
    v = (kolosov + 1) / 2 * integral.imag - y * Z.real
    return np.asarray(np.stack([u, v], axis=1) / (2 * mu))


def slanted(x: np.ndarray, a: float, moduli: Any) -> np.ndarray:
    """u of a crack |x| < a under unit tension at 45°: half of it opens, half of it slides."""
    lam, mu = moduli.C12, moduli.C44
    kolosov, z, y = (lam + 3 * mu) / (lam + mu), x[:, 0] + 1j * x[:, 1], x[:, 1]
    root = np.sqrt(z - a) * np.sqrt(z + a)
    Z = z / root
    u = (kolosov + 1) / 2 * root.imag + y * Z.real
    v = -(kolosov - 1) / 2 * root.real - y * Z.imag
    return np.asarray(westergaard(x, a, 0.5, lam, mu) + np.stack([u, v], axis=1) / (4 * mu))


def penny_crack(name: str, s: UnitScale) -> Outcome:
    """K over 2 σ √(a/π) of a penny in an endless solid, whose field is given around it."""
    a, nu, h = 8.0, 0.25, s.length
    law = replace(material("LPS", solid(1000.0, nu), 1.0, s), horizon=2 * h)
    x = box_nodes((28, 28, 28), 1.0)
    points = Points(h * x, np.abs(x).max(axis=1) < 12, h, units=s.units)
    problem = Cracked(points, u=h * penny_field(x, a, 1000.0, nu), corrected=True)
    pennies, by = [[h * penny_corners(a + d)] for d in (-1, -0.5, 0, 0.5, 1)], CG()
    G = energy_release(law, problem, pennies, solver=by)
    K2 = G / h / s.stiffness * 1000 / (1 - nu**2)
    return Outcome(float(np.sqrt(K2 * np.pi / a) / 2))


def penny_field(x: np.ndarray, a: float, E: float, nu: float) -> np.ndarray:
    """u of a penny of radius a on y = 0 under unit tension along y, shape [N, 3].

    I. N. Sneddon's (1946), his harmonic function as an integral of sources at i t, t < a.
    """
    t, weight = np.polynomial.legendre.leggauss(80)
    t, weight = a * (t + 1) / 2, a * weight / 2
    flat, away = np.hypot(x[:, 0], x[:, 2]), np.abs(x[:, 1])
    z, r = away[:, None] - 1j * t, flat[:, None]
    R, share = np.sqrt(r**2 + z**2), 2 / np.pi * t * weight
    F_z, F_r, F_zz, F_rz = (
        sign * (share * term).imag.sum(axis=1)
        for sign, term in ((-1, 1 / R), (-1, (1 - z / R) / r), (1, z / R**3), (1, r / R**3))
    )
    out = (1 + nu) / E * ((1 - 2 * nu) * F_r + away * F_rz) - nu * flat / E
    up = (1 + nu) / E * (-2 * (1 - nu) * F_z + away * F_zz) + away / E
    u: np.ndarray = np.column_stack(
        [out * x[:, 0] / flat, up * np.sign(x[:, 1]), out * x[:, 2] / flat]
    )
    return u


def griffith(name: str, s: UnitScale, *, calibrated: bool = False) -> Outcome:
    """Load at which a crack runs by its most stretched bond, over Griffith's.

    The crack comes in from the edge of a strip between grips. Calibrated, its critical stretch is
    that of a crack in an endless sheet (C7); else that of a straight cut (C6).
    """
    law, h = material(name, plane(1000.0, NU[name]).tensor, 1.0, s), s.length
    ratio = apparent_toughness(law, h) if calibrated else 1.0
    x, classes = h * rectangle_nodes(2.0 * LONG, 2.0 * LONG + 6, 1.0), bond_classes(h, 3 * h)
    points = Points(x, np.abs(x[:, 1]) < LONG * h, h, units=s.units)
    problem = Cracked(points, u=x * (0.0, 1.0), cracks=[[(-h - LONG * h, 0.0), (0.0, 0.0)]])
    growth = problem.moved(law, {"events": 2 * cut_by_spacing(classes)})
    told = spent(growth, classes, tips=1) / unit_toughness(law, classes)
    return Outcome(float(np.sqrt(told / ratio)))
