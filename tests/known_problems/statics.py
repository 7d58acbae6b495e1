"""Bodies at rest whose answers everybody knows, in metres and megapascals."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from examples.exact import compliances, plate_with_hole, roots
from warp_peri.fe_coupling.body import BodySolution
from warp_peri.fe_coupling.boundary_elements import Moduli
from warp_peri.fe_coupling.schwarz import MARGIN
from warp_peri.materials.crystal import crystal_from_lps
from warp_peri.materials.crystal_fit import fit_dispersion
from warp_peri.materials.hyperelastic.energies import EnergyTerm, Hyperelastic
from warp_peri.materials.hyperelastic.operator import HyperelasticMaterial
from warp_peri.materials.lps import LPSMaterial
from warp_peri.materials.third_order import Smoothing, ThirdOrderMaterial
from warp_peri.points.arguments import LENGTHS, Units
from warp_peri.points.mesh import make_mesh
from warp_peri.points.points import Points
from warp_peri.problems import Body, Dirichlet, solve
from warp_peri.solvers.solution import CG, Coupling, Direct, Newton

FREE = np.nan
LEVELS = 0.5, 0.7, 1.0, 1.4
"""Cells along an axis over those of a row's own numbers, for orders of convergence: the edge of a
lattice moves by a spacing from one to the next, and over less than a factor of 2.8 that is seen."""
Place = Callable[[np.ndarray], np.ndarray]
"""A field of positions, shape [n, d] both."""
ALONE = "elements alone: the body is too thin for nodes inside"


@dataclass(frozen=True)
class UnitScale:
    """A unit of length by name, and what all moduli and loads are multiplied by."""

    unit: str = "m"
    stiffness: float = 1.0

    @property
    def length(self) -> float:
        """A metre in this unit."""
        return LENGTHS["m"] / LENGTHS[self.unit]

    @property
    def units(self) -> Units:
        """Of length and stress, as materials and points name them."""
        return self.unit, "MPa"


@dataclass(frozen=True, eq=False)
class Outcome:
    """A value, or where the reference is zero the error itself; a fitted order of convergence."""

    value: float
    order: float | None = None
    note: str = ""


def mapped(
    s: UnitScale, *patches: tuple[Sequence[int], Place, Sequence[str]], split: bool = False
) -> Any:
    """A mesh of squares or cubes that are mapped to a body in metres, its sides curved.

    Of each patch the cells along the axes, the map of the unit square or cube, and the names of
    both ends of each axis, empty for those inside. Cells that are split at their centres and have
    straight sides bear ν near 1/2 as quadratic elements (D. N. Arnold and J. Qin, 1992).
    """
    x, cells, parts, first = [], [], dict[str, list[Any]](), 0
    middle = dict[tuple[int, int], Any]()
    for counts, place, names in patches:
        d = len(counts)
        grid = np.indices([n + 1 for n in counts]).reshape(d, -1).T
        ways = [np.eye(d, dtype=int)[list(p)] for p in itertools.permutations(range(d))]
        paths = np.pad(np.cumsum(ways, axis=1), ((0, 0), (1, 0), (0, 0)))
        corners = grid[(grid < counts).all(axis=1)][:, None, None] + paths
        shape = [n + 1 for n in counts]
        number = np.ravel_multi_index(tuple(np.moveaxis(corners, -1, 0)), shape).reshape(-1, d + 1)
        cells.append(first + number)
        x.append(place(grid / counts))
        for side, kept in itertools.product(range(2 * d), itertools.combinations(range(d + 1), d)):
            on = grid[:, side // 2] == (side % 2) * counts[side // 2]
            facets = number[:, kept][on[number[:, kept]].all(axis=1)]
            if names[side]:
                parts.setdefault(names[side], []).append(first + facets)
            for pair in itertools.combinations(range(d), 2):
                ends = np.sort(facets[:, pair], axis=1)
                half = place(grid[ends].mean(axis=1) / counts) * s.length
                middle |= dict(zip(map(tuple, (first + ends).tolist()), half))
        first += len(grid)
    named = {name: np.concatenate(some) for name, some in parts.items()}
    corner, cell = np.concatenate(x), np.concatenate(cells)
    if split:
        new, middle = len(corner) + np.arange(len(cell)), {}
        corner = np.concatenate([corner, corner[cell].mean(axis=1)])
        parts_of = [np.where(np.arange(d + 1) == k, new[:, None], cell) for k in range(d + 1)]
        cell = np.concatenate(parts_of)
    return make_mesh(corner * s.length, cell, named, middle)


def plane(E: float, nu: float, *, strain: bool = False) -> Moduli:
    """Isotropic moduli [MPa] in plane stress, or in plane strain."""
    mu = E / 2 / (1 + nu)
    lam = E * nu / ((1 + nu) * (1 - 2 * nu)) if strain else E * nu / (1 - nu**2)
    return Moduli.square(C11=lam + 2 * mu, C12=lam, C44=mu)


def solid(E: float, nu: float) -> np.ndarray:
    """Isotropic moduli [MPa] in space, shape [3, 3, 3, 3]."""
    one = np.eye(3)
    shear = np.einsum("ik,jl->ijkl", one, one) + np.einsum("il,jk->ijkl", one, one)
    both = nu / (1 - 2 * nu) * np.einsum("ij,kl->ijkl", one, one) + shear / 2
    return np.asarray(E / (1 + nu) * both)


LEARNED = "learned graphene"
"""An LPS; whatever moduli a problem has, it has graphene's [TPa] as of MPa, and its lattice."""
GRAPHENE = Moduli.square(C11=1.2489694, C12=-0.1972324, C44=0.7231009)
KERNEL = (
    *(57318.68005537288, -7682.257643742318, -21397.531890166872, 19176.5404004845),
    *(1782.6088811683771, -19133.41797273666, 22198.57879157073, -15194.008296304488),
    *(6822.203308012383, -1722.5397543905112, -1.0746915181453978),
)
"""What the first command learns from LAMMPS, its moduli of long waves beside it."""
THIRD = plane(1.0, 1 / 3).tensor
"""Of ν = 1/3, where bonds alone are an isotropic sheet."""
CUBIC = Moduli.square(C11=170.0, C12=122.0, C44=76.0)
"""About copper's in a plane [MPa]."""


def material(name: str, C: np.ndarray, h: float, s: UnitScale) -> Any:
    """A material by its name, of moduli [MPa] and for nodes h metres apart.

    LPS and bond-based have the influence function 1/r on 28 bonds; third order and the sheet
    energy are linear at small strain only.
    """
    C, h, d = s.stiffness * C, s.length * h, len(C)
    lam, mu = C[0, 0, 1, 1], C[0, 1, 0, 1]
    if name == "crystal":
        symmetry, reach = {2: ("4mm", 2.5), 3: ("m-3m", 2.0)}[d]

        def local(k: np.ndarray) -> np.ndarray:
            return np.asarray(np.einsum("ijkl,nj,nl->nik", C, k, k))

        return fit_dispersion(local, h, reach * h, symmetry=symmetry, tensor=C, units=s.units)
    if name == LEARNED:
        how: dict[str, Any] = {"alpha": 1.0, "horizon": 4 * h, "certified_on": (h,)}
        lam, mu = s.stiffness * GRAPHENE.C12, s.stiffness * GRAPHENE.C44
        return LPSMaterial(lam, mu, D=np.array(KERNEL), units=s.units, **how)
    if name == "sheet energy":
        near = ((0, 1), (1, 0), (1, 1), (1, -1))
        terms = Hyperelastic(3.0, near, (EnergyTerm("neo_hookean"), EnergyTerm("volumetric")))
        c = np.array([mu, mu, mu, mu, mu / 2, lam / 2])
        return HyperelasticMaterial(terms, c, h, units=s.units)
    plain = LPSMaterial(
        lam, mu, 1.0, np.ones(1), 3 * h, certified_on=(h,), units=s.units, dimension=d
    )
    if name == "third order":
        own = Smoothing(2 * h, 0.2), "energy", 3 * h
        return ThirdOrderMaterial(crystal_from_lps(plain, h), -lam, -mu, mu, *own)
    return plain


def posed(
    law: Any,
    mesh: Any,
    s: UnitScale,
    held: dict[str, Any],
    pulled: dict[str, Any] | None = None,
    level: float = LEVELS[0],
    wide: int | None = None,
) -> BodySolution:
    """A body at rest; what is held [m] and pulled [MPa] are vectors or functions of metres.

    At finer levels elements reach as deep, and nodes overlap by as much, as at the first: what
    grows or shrinks with the spacing changes the error too. `wide` is the overlap in spacings.
    """

    def at(value: Any, size: float) -> Any:
        if callable(value):
            return lambda x, *n: size * value(x / s.length, *n)
        return size * np.asarray(value, dtype=float)

    given = {name: at(value, s.length) for name, value in held.items()}
    loads = {name: at(value, s.stiffness) for name, value in (pulled or {}).items()}
    h, usual = (law.certified_on[0], 6) if isinstance(law, LPSMaterial) else (law.spacing, 4)
    reach, coarse = (2 if isinstance(law, LPSMaterial) else 1) * law.horizon, level / LEVELS[0]
    deep = (reach + MARGIN * h) * coarse if law.dimension == 2 else None  # room is dear in space
    coupling = Coupling(spacing=h, overlap=(wide or usual) * h * coarse, depth=deep, tolerance=1e-9)
    found: BodySolution = solve(law, Body(mesh, given, loads, coupling=coupling)).details
    return found


def near(found: BodySolution, x: Sequence[float], s: UnitScale) -> tuple[np.ndarray, np.ndarray]:
    """u [m] and σ [MPa] at the corner nearest to a place [m]."""
    u, stress = found.on_corners()
    at = int(np.argmin(np.linalg.norm(found.rim.mesh.x - s.length * np.asarray(x), axis=1)))
    return u[at] / s.length, stress[at] / s.stiffness


def off(found: BodySolution, exact: Place, s: UnitScale) -> float:
    """Relative ℓ2 error of the displacement, the larger one of elements and nodes."""
    sets = [(found.rim.x, found.u_rim)]
    sets += [] if found.points is None else [(found.points.x, found.u_bulk)]
    right = [s.length * exact(x / s.length) for x, _ in sets]
    return max(float(np.linalg.norm(u - r) / np.linalg.norm(r)) for (_, u), r in zip(sets, right))


def order(steps: Sequence[float], errors: Sequence[float]) -> float:
    """Fitted power of the step with which errors fall."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def refined(
    pose: Callable[[float], BodySolution],
    exact: Place,
    s: UnitScale,
    levels: Sequence[float] = LEVELS,
) -> tuple[float, Any]:
    """Fitted order of the errors of bodies at some levels, and the finest body."""
    found = [pose(level) for level in levels]
    return order([1 / level for level in levels], [off(one, exact, s) for one in found]), found[-1]


def times(level: float, *counts: int) -> list[int]:
    """Counts of cells at a level, even."""
    return [2 * round(level * count / 2) for count in counts]


def outcome(found: BodySolution, value: float, power: float | None = None) -> Outcome:
    """A value of a body, which says where elements were alone."""
    return Outcome(value, power, ALONE if found.points is None else "")


NEARLY = 0.49
"""ν from which elements are split."""


def arc(p: np.ndarray) -> np.ndarray:
    """Unit vectors of a quarter turn, by the second coordinate of the unit square."""
    return np.stack([np.cos(np.pi / 2 * p[:, 1]), np.sin(np.pi / 2 * p[:, 1])], axis=1)


def square(corners: Sequence[Sequence[float]], p: np.ndarray) -> np.ndarray:
    """The bilinear map of the unit square to corners at (0, 0), (1, 0), (1, 1), (0, 1)."""
    a, b = p[:, :1], p[:, 1:2]
    shares = np.concatenate([(1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b], axis=1)
    return np.asarray(shares @ np.array(corners, dtype=float))


def ellipses(p: np.ndarray) -> np.ndarray:
    """NAFEMS's plate: from (x/2)² + y² = 1 to (x/3.25)² + (y/2.75)² = 1, a quarter."""
    t = p[:, :1] ** 1.3
    bent = np.stack([p[:, 0], p[:, 1] ** 1.2], axis=1)
    return np.asarray(((1 - t) * [2.0, 1.0] + t * [3.25, 2.75]) * arc(bent))


SIDES = "low", "high"
"""Names of the axes of symmetry of a quarter."""


def rollers(d: int = 2) -> dict[str, Any]:
    """Held on the first two axes of symmetry."""
    return {"low": (FREE, 0, FREE)[:d], "high": (0, FREE, FREE)[:d]}


def sheet(n: int, s: UnitScale, *, angle: float = 0.0, jitter: float = 0.0, d: int = 2) -> Points:
    """A unit square or cube of n interior nodes a side with a collar of six spacings at least."""
    wide = 10 if jitter or d == 2 else 6
    line = (np.arange(-wide, n + wide) - (n - 1) / 2) / n
    x = np.stack(np.meshgrid(*d * [line], indexing="ij"), axis=-1).reshape(-1, d)
    inside = np.abs(x).max(axis=1) < 0.5
    x += jitter / n * np.random.default_rng(0).uniform(-1, 1, x.shape)
    turn = np.eye(d)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    h, axis = 0.0 if jitter else s.length / n, {2: np.degrees(angle), 3: turn}[d]
    return Points(s.length * x @ turn.T, inside, h, units=s.units, axis=axis)


def given(
    law: Any, points: Points, exact: Place, load: Place, s: UnitScale, solver: Any = None
) -> float:
    """Error of a solve between given displacements [m] under a load [MPa/m]."""
    x, inside = points.x / s.length, points.interior
    right, b = exact(x), load(x) * s.stiffness / s.length
    off_lattice: dict[str, Any] = {} if points.spacing else {"allow_uncertified": True}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="spacing: the model is certified")
        u = solve(law, Dirichlet(points, b, s.length * right), solver=solver, **off_lattice).u
    u = u / s.length
    return float(np.linalg.norm((u - right)[inside]) / np.linalg.norm(right[inside]))


def uniform(x: np.ndarray) -> np.ndarray:
    """A displacement gradient so small that the laws of small strain are linear."""
    H = 1e-6 * np.array([[1.0, 0.7, 0.0], [-0.3, -0.5, 0.0], [0.0, 0.0, 0.4]])
    return np.asarray(x @ H[: x.shape[1], : x.shape[1]].T)


def patch(name: str, s: UnitScale, **how: Any) -> Outcome:
    """Uniform strain from the collar: error of the displacement."""
    d = how.get("d", 2)
    n, C = {2: (9, THIRD), 3: (5, solid(1.0, 0.25))}[d]
    points, law = sheet(n, s, **how), material(name, C, 1 / n, s)
    solver: Any = Direct() if type(law) is LPSMaterial else CG(tolerance=1e-13)
    solver = {"third order": Newton(tolerance=1e-13), "sheet energy": None}.get(name, solver)
    solver = solver if points.spacing else None
    return Outcome(given(law, points, uniform, np.zeros_like, s, solver))


WAVES = np.array([[2.0, 1.0], [-1.0, 2.5], [0.5, -2.0]])
SIZES = 1e-7 * np.array([[1.0, 0.4], [-0.6, 0.8], [0.3, -1.0]])


def smooth(name: str, s: UnitScale) -> Outcome:
    """Three waves under the body force of their stress: error of the displacement, its order.

    A side is at least 2⅔ horizons long: that of the learned law is a third longer than others.
    """
    C = GRAPHENE.tensor if name == LEARNED else THIRD
    pulls = np.einsum("ijkl,nj,nl,nk->ni", C, WAVES, WAVES, SIZES)
    counts, errors = (11, 16, 24) if name == LEARNED else (8, 12, 18), list[float]()
    for n in counts:
        law, on = material(name, C, 1 / n, s), sheet(n, s)
        waves, load = (lambda x, a=a: np.sin(x @ WAVES.T + 0.3) @ a for a in (SIZES, pulls))
        errors.append(given(law, on, waves, load, s))
    return Outcome(errors[-1], -order(counts, errors))


def patch_body(name: str, s: UnitScale) -> Outcome:
    """Uniform strain from one side, its stress on the others and in the hole."""
    stress = np.einsum("ijkl,kl->ij", THIRD, uniform(np.eye(2)).T)
    pulls = dict.fromkeys((*SIDES, "hole"), lambda x, n: n @ stress)
    found = posed(material(name, THIRD, 0.1, s), quarter(0.6, s), s, {"side": uniform}, pulls)
    return outcome(found, off(found, uniform, s))


def quarter(level: float, s: UnitScale) -> Any:
    """A quarter of a plate of half side 4 about a round hole of radius 1."""

    def place(p: np.ndarray) -> np.ndarray:
        t, circle = p[:, :1] ** 1.4, arc(p)
        return np.asarray(circle * (1 - t) + t * 4 * circle / circle.max(axis=1, keepdims=True))

    return mapped(s, (times(level, 28, 80), place, ("hole", "side", *SIDES)))


def hole(name: str, s: UnitScale, *, cubic: bool = False) -> Outcome:
    """Hoop stress over the tension at the top of a hole, and the order of the displacement."""
    moduli = CUBIC if cubic else plane(1.0, 1 / 3)

    def exact(x: np.ndarray) -> np.ndarray:
        return plate_with_hole(x, 1.0, 1.0, moduli)[0]

    def pose(level: float) -> BodySolution:
        law = material(name, moduli.tensor, 0.04 / level, s)
        return posed(law, quarter(level, s), s, {"side": exact} | rollers(), level=level)

    power, found = refined(pose, exact, s)
    return outcome(found, near(found, (0, 1), s)[1][0, 0], power)


def half_plane(name: str, s: UnitScale) -> Outcome:
    """Hoop stress under the crest of a wave of pressure cos πx on a half-plane, over it.

    Its potentials fall with the depth. A square of it has their displacement on three sides.
    """
    (a11, a12, _), k = compliances(CUBIC), roots(CUBIC)
    size = np.array([-k[1], k[0]]) / (k[1] - k[0]) / 2  # the pressure, and no shear, on y = 0

    def exact(x: np.ndarray) -> np.ndarray:
        waves = 2j / np.pi * size * np.exp(-1j * np.pi * (x[:, :1] + k * x[:, 1:]))
        factors = np.stack([a11 * k**2 + a12, a12 * k + a11 / k])
        return np.asarray((waves @ factors.T).real)

    def pull(x: np.ndarray, n: np.ndarray) -> np.ndarray:
        return np.stack([0 * x[:, 0], -np.cos(np.pi * x[:, 0])], axis=1)

    def pose(level: float) -> BodySolution:
        corners = [(-1, -2), (1, -2), (1, 0), (-1, 0)]
        names = ("held", "held", "held", "top")
        mesh = mapped(s, (times(level, 60, 60), lambda p: square(corners, p), names))
        law = material(name, CUBIC.tensor, 0.02 / level, s)
        return posed(law, mesh, s, {"held": exact}, {"top": pull}, level)

    power, found = refined(pose, exact, s)
    told = 2 * float((k**2 * size).sum().real)
    return outcome(found, near(found, (0, 0), s)[1][0, 0] / told, power)


def cook(name: str, s: UnitScale, nu: float, strain: bool = False) -> Outcome:
    """v at the middle of the right end of a tapered plate, of a unit force on it."""

    def place(p: np.ndarray) -> np.ndarray:  # finer at the upper left corner
        bent = np.stack([p[:, 0] ** 1.5, 1 - (1 - p[:, 1]) ** 1.5], axis=1)
        return square([(0, 0), (48, 44), (48, 60), (0, 44)], bent)

    law = material(name, plane(1.0, nu, strain=strain).tensor, 0.9, s)
    mesh = mapped(s, ((40, 40), place, ("held", "end", "", "")))
    found = posed(law, mesh, s, {"held": (0, 0)}, {"end": (0, 1 / 16)})
    end = s.length * (1 - 1e-12) * np.array([[48.0, 52.0]])
    return outcome(found, found.displacement(end)[0, 1] / s.length)


def cantilever(name: str, s: UnitScale) -> Outcome:
    """Deflection of the tip under a parabolic shear, over that of the theory."""
    nu, far, corners = 1 / 3, 4.0, [(0, -0.5), (4, -0.5), (4, 0.5), (0, 0.5)]

    def exact(x: np.ndarray) -> np.ndarray:
        a, y = x.T
        u = y * ((6 * far - 3 * a) * a + (2 + nu) * (y**2 - 1 / 4))
        v = 3 * nu * y**2 * (far - a) + (4 + 5 * nu) * a / 4 + (3 * far - a) * a**2
        return np.asarray(2 * np.stack([u, -v], axis=1))

    def pull(x: np.ndarray, n: np.ndarray) -> np.ndarray:
        return np.stack([0 * x[:, 1], 6 * x[:, 1] ** 2 - 1.5], axis=1)

    def pose(level: float) -> BodySolution:
        names = ("held", "end", "", "")
        mesh = mapped(s, (times(level, 100, 26), lambda p: square(corners, p), names))
        law = material(name, plane(1.0, nu).tensor, 0.017 / level, s)
        return posed(law, mesh, s, {"held": exact}, {"end": pull}, level, wide=6)  # slender

    power, found = refined(pose, exact, s)
    tip = near(found, (far, 0), s)[0][1] / exact(np.array([[far, 0.0]]))[0, 1]
    return outcome(found, tip, power)


def cylinder(name: str, s: UnitScale, nu: float, *, stress: bool = False) -> Outcome:
    """u of the bore under a unit pressure, or its hoop stress; radii 3 and 9, E = 1000.

    The finest lattice has 120 spacings from bore to skin.
    """
    moduli = plane(1000.0, nu, strain=True)

    def exact(x: np.ndarray) -> np.ndarray:
        r2 = (x**2).sum(axis=1)[:, None]
        return np.asarray(x / 16 * (1 / (moduli.C12 + moduli.C44) + 81 / (moduli.C44 * r2)))

    def pose(level: float) -> BodySolution:
        patch = times(level, 58, 92), lambda p: (3 + 6 * p[:, :1] ** 1.2) * arc(p)
        law = material(name, moduli.tensor, 0.07 / level, s)
        mesh = mapped(s, (*patch, ("bore", "", *SIDES)), split=nu > NEARLY)
        return posed(law, mesh, s, rollers(), {"bore": lambda x, n: -n}, level)

    power, found = (None, pose(1.0)) if stress else refined(pose, exact, s)
    u, hoop = near(found, (3, 0), s)
    return outcome(found, hoop[1, 1] if stress else u[0], power)


def cavity(name: str, s: UnitScale) -> Outcome:
    """u of a cavity under a unit pressure in a ball, over Lamé's; radii 1 and 3, an octant."""
    C = solid(1.0, 0.3)
    corners = np.array([(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)])
    corners = corners / np.linalg.norm(corners, axis=1)[:, None]

    def exact(x: np.ndarray) -> np.ndarray:
        r3, bulk = np.linalg.norm(x, axis=1)[:, None] ** 3, C[0, 0, 0, 0] + 2 * C[0, 0, 1, 1]
        return np.asarray(x / 26 * (1 / bulk + 27 / (4 * C[0, 1, 0, 1] * r3)))

    def part(k: int, level: float) -> Any:
        def place(p: np.ndarray) -> np.ndarray:
            out = square(np.roll(corners, k, axis=1).tolist(), p)
            return np.asarray((1 + 2 * p[:, 2:]) * out / np.linalg.norm(out, axis=1)[:, None])

        sides = "xyz"[(k + 1) % 3], "", "xyz"[(k + 2) % 3], "", "void", ""
        return times(level, 6, 6, 8), place, sides

    def pose(level: float) -> BodySolution:
        mesh = mapped(s, *(part(k, level) for k in range(3)))
        held = {a: np.where(np.arange(3) == n, 0, FREE) for n, a in enumerate("xyz")}
        law = material(name, C, 0.06 / level, s)
        return posed(law, mesh, s, held, {"void": lambda x, n: -n}, level)

    power, found = refined(pose, exact, s, LEVELS[:-1])
    one = np.array([[1.0, 0.0, 0.0]])
    return outcome(found, near(found, one[0].tolist(), s)[0][0] / exact(one)[0, 0], power)


def membrane(name: str, s: UnitScale) -> Outcome:
    """σ_yy at D of NAFEMS's elliptic membrane under 10 MPa."""
    mesh = mapped(s, ((40, 80), ellipses, ("", "skin", *SIDES)))
    law = material(name, plane(210e3, 0.3).tensor, 0.04, s)
    found = posed(law, mesh, s, rollers(), {"skin": lambda x, n: 10 * n})
    return outcome(found, near(found, (2, 0), s)[1][1, 1])


def thick_plate(name: str, s: UnitScale) -> Outcome:
    """σ_yy at D of NAFEMS's thick plate under 1 MPa."""

    def place(p: np.ndarray) -> np.ndarray:
        return np.concatenate([ellipses(p), 0.6 * p[:, 2:] - 0.3], axis=1)

    def skin(x: np.ndarray) -> np.ndarray:
        middle = np.abs(x[:, 2]) < 1e-6
        return np.stack([0 * middle, 0 * middle, np.where(middle, 0.0, FREE)], axis=1)

    mesh = mapped(s, ((6, 12, 8), place, ("", "skin", *SIDES, "", "top")))
    law = material(name, solid(210e3, 0.3), 0.05, s)
    found = posed(law, mesh, s, rollers(3) | {"skin": skin}, {"top": lambda x, n: -n})
    return outcome(found, near(found, (2, 0, 0.3), s)[1][1, 1])
