"""Fits of the LPS to displacements and loads: loss, degree, stages, checks, certificate."""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from typing import Any, Literal

import numpy as np
from numpy import ndarray
from tqdm.auto import tqdm

from warp_peri import __version__
from warp_peri.core.elastic import difference_tensors
from warp_peri.core.proof import certify
from warp_peri.core.stencil import Stencil, block, grid_of
from warp_peri.core.torch_bridge import own_torch
from warp_peri.errors import InputError, warn
from warp_peri.fitting.augmented_lagrangian import Tick, to_the_optimum
from warp_peri.fitting.long_waves import lame_of_long_waves
from warp_peri.fitting.regression import (
    LatticeRows,
    Regression,
    compressed,
    over_loads,
    relative,
    sample_weights,
    sizes,
    without_noise,
)
from warp_peri.fitting.result import Fit, LossSelection, Stage, check_noise
from warp_peri.materials.crystal_fit import POOR
from warp_peri.materials.influence import shapes_of
from warp_peri.materials.lps import LPSMaterial, LPSParameters, moduli
from warp_peri.materials.lps_force import Bonds
from warp_peri.materials.lps_law import (
    HEADROOM,
    LONG_WAVES,
    AugmentedLagrangian,
    Bernstein,
    GaussNewton,
    Kernel,
    LPSFound,
    LPSLaw,
    Method,
    Products,
    StabilityConditions,
    TwoStage,
    has_answers,
    optimum,
    products,
    squares,
)
from warp_peri.materials.lps_stages import SMALLEST_MODULUS, fit_output_error, in_torch, two_stages
from warp_peri.materials.transfer import check_carried
from warp_peri.points.arguments import Positive, symbols, typed
from warp_peri.points.dataset import Dataset, largest_wave_number, sets_of
from warp_peri.points.families import largest_strain
from warp_peri.points.points import WAVE_VECTOR, Samples, check_lattice
from warp_peri.solvers.systems import definite_factors

RELATIVE_ZETA = 0.0161
"""ζ over the stiffness that the data show, where none was asked for: 0.0100 TPa on graphene."""
USUAL_STIFFNESS = 0.6212640458
"""A stiffness [TPa] that the steps of Adam suit: that which graphene's data show."""
LARGEST_DEGREE, FOLDS, AS_GOOD = 10, 5, 1.02
"""Degree that is tried where none is asked for, parts of the loads that are left out in turn, and
how many times the least error of those another degree's may be."""
SAME_LOSS = 1e-6
"""Relative: starts that end so near to one another have found one optimum."""
SMALL_SHARE = 0.01
"""A residual loss is taken as it is when noise is less than this of its squares."""
ON_BOUND = 1e-3
"""A modulus this near its bound, relative, has ended there."""
PLAIN_EXPONENTS = (1.0, 2.0, 2.9)
"""Kernels r^(−α) that an optimum is looked for from."""
AGREE, SPREADS = 0.02, 2.0
"""Of the largest modulus, how sure long waves must be; standard errors beyond which they hold."""
MOST_NODES, REACHES = 2000, range(8, 1, -1)
"""Unknown nodes up to which a fit is compared with local elasticity, and reaches of its central
differences, of which the widest that fit count."""
ERROR_TOLERANCE, ROUNDING = 1e-6, 1e-8
"""By which the residual by rows may depart from the operator's: of it, and of the loads."""


@typed
@dataclass(frozen=True)
class LPS:
    """Settings of a fit of the linear peridynamic solid and its influence function (4–9, V7).

    Attributes:
        horizon: δ [Å], at least one spacing.
        kernel: Bernstein polynomials, or a function of the bond length whose parameters are
            learned, from the values it has. Several functions are several starts, and the best is
            kept; one that is led out of its domain is passed over. None takes the smallest degree
            whose error on loads left out, in five parts, is within 2 % of the best.
        method: GaussNewton() starts at the constrained optimum, from plain kernels; TwoStage() is
            Algorithm 1 of You et al. (2021); AugmentedLagrangian() takes Adam there and checks it.
        conditions: what must hold on every lattice.
        loss: "residual" is (10); "corrected" takes off what noise adds to it; "output" goes on to
            fit displacement, at the wave vectors of the loads (`wave_vector` of the samples) or as
            solved with the collar given; "auto" takes the residual where noise does not matter,
            unless local elasticity of the same moduli has the better training displacement.
        normalise: divide each sample by ‖b‖ in the residual.

    Raises InputError for a horizon that is no number > 0. `fit` does for one below a spacing and
    for settings of other kinds, and RuntimeError where no start of the search keeps the conditions.

    >>> wp.fit(samples, wp.LPS(12.5, wp.Bernstein(3))).certificate.holds
    True
    """

    horizon: Positive
    kernel: Kernel | None = None
    method: Method = GaussNewton()  # noqa: RUF009 (frozen values)
    conditions: StabilityConditions = StabilityConditions()  # noqa: RUF009
    loss: Literal["auto", "residual", "corrected", "output"] = "auto"
    normalise: bool = False

    def learn(
        self,
        samples: Samples | Dataset | Sequence[Samples],
        *,
        noise: Samples | Sequence[Samples] | None = None,
        progress: bool | None = None,
    ) -> Fit:
        """Learn λ, μ, α and D from one set or several, on different lattices.

        Args:
            samples: of a Dataset `train`, or its only set. Interior nodes need the 2δ collar.
            noise: fields of noise alone on the nodes of each; TwoStage and "residual" use none.
            progress: show a bar for each stage; None shows it on a terminal and in a notebook.

        Raises InputError for input that cannot be used, and in space "paper", TwoStage, "output";
        RuntimeError when rows depart from Warp's operator or no start keeps conditions and moduli.
        """
        return Learner(self, sets_of(samples), sets_of(noise, "noise"), progress).fit()

    def check_samples(self, samples: Samples, spacing: float | None = None) -> None:
        """Raise InputError for samples to learn from that `learn` refuses, and for nodes that a
        material learned at a `spacing` refuses."""
        self.checked(samples.dimension)
        if spacing is None:
            sample_weights([samples], normalise=self.normalise)
        check_carried(self.horizon, samples.points, spacing)

    def checked(self, dimension: int) -> None:
        """Raise InputError for settings that contradict one another or the dimension."""
        kernel, printed = self.kernel, isinstance(self.method, TwoStage)
        if printed and self.loss in ("corrected", "output"):
            raise InputError(f"loss: {self.loss!r} is not for the two-stage method")
        apart = printed or self.conditions.kind != "direct" or self.loss == "output"
        if dimension == 3 and apart:
            raise InputError(
                'samples: in space expected "direct" conditions, no TwoStage, and '
                "another loss than displacement"
            )
        if kernel is None or isinstance(kernel, Bernstein):
            return
        shapes_of(kernel)
        if printed:
            raise InputError("kernel: functions are learned by GaussNewton or AugmentedLagrangian")


class Learner:
    """State of one LPS fit: its data, and its timed stages; `history`, `starts` and `degrees`
    become those of the Fit. `lattices` are bond classes, `weights` those of each set's samples in
    the loss, `blocks` its rows. InputError for sets that cannot be learned from."""

    def __init__(
        self, law: LPS, sets: list[Samples], noise: list[Samples], progress: bool | None
    ) -> None:
        self.law, self.sets, self.noise = law, sets, noise
        law.checked(max((each.dimension for each in sets), default=2))
        for each in sets:
            check_lattice(each)
        self.weights = weights = sample_weights(sets, normalise=law.normalise)
        if noise and len(noise) != len(sets):
            raise InputError(f"noise: expected {len(sets)} sets, got {len(noise)}")
        for pair in zip(noise, sets):
            check_noise(*pair)
        self.products = [Products(each, law.horizon) for each in sets]
        self.lattices = [one.classes for one in self.products]
        self.stiffness = stiffness_of(sets, law.horizon)
        self.zeta = law.conditions.zeta or RELATIVE_ZETA * self.stiffness
        self.conditions = replace(law.conditions, zeta=self.zeta)
        self.flat = sets[0].dimension == 2
        self.disable = None if progress is None else not progress
        self.history: list[Stage] = []
        self.starts: dict[str, float] = {}
        self.degrees: dict[int, float] = {}
        self.folds: list[list[tuple[LatticeRows, float]]] = []
        count = min(FOLDS, *map(len, sets)) if law.kernel is None else 1
        for each, w, made in zip(sets, weights, self.products):
            order = np.random.default_rng(0).permutation(len(each))
            parts = [np.sort(order[n::count]) for n in range(count)]
            self.folds.append([(made.rows(w[k], each[k]), w[k].sum()) for k in parts])
        self._noise = [
            made.rows(np.full(len(of), 1 / len(of)), Samples(of.points, of.u, 0 * of.u)).R
            for of, made in zip(noise, self.products)
        ]
        self.blocks = self.rows("residual")

    def rows(self, loss: str, folds: Sequence[int] | None = None) -> list[LatticeRows]:
        """Rows of a loss on each lattice, of all loads or some folds; "corrected" for "output"."""
        found = []
        for number, parts in enumerate(self.folds):
            of = parts if folds is None else [parts[n] for n in folds]
            R, y = compressed(*map(np.concatenate, zip(*((one.R, one.y) for one, _ in of))))
            if loss != "residual" and self.noise:
                weight = sum(weight for _, weight in of)
                R, y = without_noise(R, y, np.sqrt(weight) * self._noise[number])
            found.append(replace(of[0][0], R=R, y=y))
        return found

    def model(self, found: LPSFound) -> LPSMaterial:
        """Make the material from a fitted solid and its known facts."""
        of, numbers, horizon = self.sets[0], vars(found.solid), self.law.horizon
        return LPSMaterial(**numbers, horizon=horizon, dimension=of.dimension, units=of.units)

    def optimum(
        self, start: LPSFound, method: GaussNewton, blocks: list[LatticeRows] | None = None
    ) -> LPSFound:
        """The constrained optimum from one start; InputError where a function leaves its domain."""
        return optimum(blocks or self.blocks, self.lattices, start, self.conditions, method)

    @own_torch()
    def fit(self) -> Fit:
        """Run all stages of the fit and certify the result."""
        law, method, kernel = self.law, self.law.method, self.law.kernel
        starts = self.plain(kernel or Bernstein(self.largest_degree()))
        probe = [*starts][:2][-1]  # from which the share of noise, and what moduli cost, are found
        choice = self.choose_loss(starts[probe])
        self.blocks = self.rows(choice.name)
        asked = method if isinstance(method, GaussNewton) else GaussNewton(moduli=None)
        if isinstance(method, AugmentedLagrangian):
            asked = method.optimum
        asked = self.hold(asked, starts, probe)
        if kernel is None:
            kernel = self.choose_degree(choice.name, asked)
            starts = self.plain(kernel)
        if isinstance(method, TwoStage):
            final = two_stages(self, kernel, method)
        else:
            if isinstance(method, AugmentedLagrangian) and isinstance(kernel, Bernstein):
                starts = {"Adam": self.adam(kernel, method, asked)} | starts
            final = self.run("3 constrained", lambda tick: self.best(starts, asked, tick))
            plain = law.loss == "auto" and choice.name == "residual" and has_answers(self.sets)
            if plain and self.worse(final, asked):
                why = "the residual's optimum is worse than local elasticity"
                choice = LossSelection("output", why)
            if choice.name == "output":
                final = self.run("4 output error", partial(fit_output_error, self, final, asked))
        left = self.check(final, choice.name)
        done = replace(law, kernel=kernel, method=asked, conditions=self.conditions)
        return replace(self.certified(final, done, choice), left=left)

    def plain(self, kernel: Kernel) -> dict[str, LPSFound]:
        """Starts of the search by name: plain kernels, or the functions given."""
        if isinstance(kernel, Bernstein):
            ones = np.ones(1 + kernel.degree)
            plain = PLAIN_EXPONENTS[: None if self.flat else 1]  # in space α stays as it begins
            return {
                f"r^-{a:.3g}": LPSFound(LPSParameters(0.0, self.stiffness, a, ones)) for a in plain
            }
        found = {}
        for number, shape in enumerate(shapes_of(kernel)):
            D, _ = shape.coefficients(self.lengths, self.law.horizon)
            found[f"{number} {shape.name}"] = LPSFound(LPSParameters(0.0, self.unit, 0.0, D), shape)
        return found

    @property
    def lengths(self) -> ndarray:
        """Bond lengths of all lattices."""
        return np.concatenate([classes.r for classes in self.lattices])

    def choose_loss(self, start: LPSFound) -> LossSelection:
        """Select the loss, as asked, or for "auto" by noise; InputError for one without data."""
        asked, printed = self.law.loss, isinstance(self.law.method, TwoStage)
        if asked == "corrected" and not self.noise:
            raise InputError("loss: 'corrected' needs fields of noise")
        if asked == "output" and not has_answers(self.sets):
            raise InputError("loss: 'output' needs a collar, or waves of which each load is one")
        if asked != "auto":
            return LossSelection(asked, "asked for")
        if printed and self.noise:
            warn("noise: the two-stage method takes nothing off for it, and its fit is biased")
        if printed or not self.noise:
            no_other = "Algorithm 1 has no other", "no fields of noise were given"
            return LossSelection("residual", no_other[not printed])
        found = self.model(self.optimum(start, GaussNewton()))
        weights = (sum(weight for _, weight in parts) for parts in self.folds)
        c = [products(found, classes) for classes in self.lattices]
        made = sum(w * np.sum((N @ p) ** 2) for w, N, p in zip(weights, self._noise, c))
        share = made / squares(self.blocks, self.lattices, found)
        why = f"noise is {100 * share:.3g} % of the squared residual at its optimum"
        if share < SMALL_SHARE:
            return LossSelection("residual", why)
        waves = all(WAVE_VECTOR in points.arrays for points in self.sets)
        return LossSelection("output" if waves else "corrected", why)

    def largest_degree(self) -> int:
        """Largest useful degree: that of as many coefficients as there are bond lengths."""
        return min(LARGEST_DEGREE, len(np.unique((self.lengths / self.law.horizon).round(9))) - 1)

    def choose_degree(self, loss: str, method: GaussNewton) -> Bernstein:
        """Select the smallest degree whose error on loads left out is within 2 % of the best, going
        down from the largest until one is worse; the largest for a single load."""
        degree = self.largest_degree()
        count, best, chosen = len(self.folds[0]), np.inf, degree
        splits = [
            [self.rows(loss, [n for n in range(count) if n != fold]), self.rows(loss, [fold])]
            for fold in range(count if count > 1 else 0)
        ]
        while degree >= 0 and splits:
            start = LPSFound(LPSParameters(0.0, self.stiffness, 1.0, np.ones(1 + degree)))
            left = 0.0
            for others, own in splits:
                start = self.optimum(start, method, others)  # the next part's begins there
                left += squares(own, self.lattices, self.model(start))
            self.degrees[degree] = error = float(np.sqrt(left))
            if error > AS_GOOD * best:
                break
            best, chosen, degree = min(best, error), degree, degree - 1
        return Bernstein(chosen)

    def run(self, name: str, stage: Callable[[Tick], LPSFound]) -> LPSFound:
        """Run, time and record one stage of the fit."""
        begin, steps = time.perf_counter(), 0
        with tqdm(desc=name, unit=" steps", disable=self.disable) as bar:  # its end is not known

            def tick(loss: float) -> None:
                nonlocal steps
                steps += 1
                bar.update()
                if steps % 100 == 0:
                    bar.set_postfix_str(f"relative residual {100 * np.sqrt(loss):.2f} %")

            found = stage(tick)
        left = np.concatenate(self.left(found))
        over = np.concatenate([over_loads(each) for each in self.sets])
        error, seconds = float((left * over)[over > 0].mean()), time.perf_counter() - begin
        self.history.append(Stage(name, found.solid, error, seconds, found.losses, steps))
        return found

    def left(self, found: LPSFound) -> list[ndarray]:
        """Residual ‖L u − b‖ of every sample of each set by Warp's operator."""
        return [one.left(*found.solid.values()) for one in self.products]

    def hold(self, method: GaussNewton, starts: dict[str, LPSFound], probe: str) -> GaussNewton:
        """Set the method to hold the long-wave moduli if asked and a free fit misses them."""
        free = replace(method, moduli=method.held)
        if method.moduli != LONG_WAVES or self.noise or not self.flat:
            return free
        try:
            waves = lame_of_long_waves(self.sets)
            held = replace(method, moduli=(waves.lam, waves.mu))
            alone = min((self.optimum(one, free) for one in starts.values()), key=lambda f: f.loss)
            model = self.model(alone)
            own = [moduli(model, classes) for classes in self.lattices]
            off = np.abs([(of["C12"] - waves.lam, of["C44"] - waves.mu) for of in own])
            sure = waves.errors.max() <= AGREE * (waves.lam + 2 * waves.mu)
            sure &= waves.misfit <= min(POOR, alone.loss**0.5)  # else the fit tells more than they
            apart = (off > SPREADS * waves.errors).any()
            beside = self.optimum(starts[probe], held) if sure and apart else None
        except InputError:  # they do not tell, or a function is not defined where it was led
            return free
        good = beside is not None and beside.converged and beside.loss <= POOR**2
        return held if good else free

    @property
    def unit(self) -> float:
        """Unit of moduli for the steps of Adam [stress]."""
        return self.stiffness / USUAL_STIFFNESS

    def adam(self, kernel: Bernstein, method: AugmentedLagrangian, asked: GaussNewton) -> LPSFound:
        """Run Adam and the augmented Lagrangian on Warp's operator, from a random kernel."""
        D = np.random.default_rng(method.seed).uniform(size=1 + kernel.degree)
        rough = LPSFound(LPSParameters(0.0, self.unit, 1.0, D))
        law = LPSLaw(self.lattices, rough, self.conditions, asked)
        problem = Regression(self.rows("residual"), law, law.zeta, 1.0)
        given = problem, law.start(rough), in_torch(self.products, self.weights, law), method
        return self.run("1 Adam", lambda tick: law.found(*to_the_optimum(*given, tick)))

    def best(self, starts: Mapping[str, LPSFound], method: GaussNewton, tick: Tick) -> LPSFound:
        """Stage 3: the best optimum from all starts; RuntimeError when none keeps conditions."""
        results = []
        for name, start in starts.items():
            try:
                results.append(reached := self.optimum(start, method))
            except InputError as error:  # a function that is not defined where it was led
                failed = error
                continue
            tick(reached.loss)
            self.starts[name] = float(np.sqrt(reached.loss))
        if not results:
            raise failed
        if not (kept := [reached for reached in results if reached.converged]):
            raise RuntimeError(
                "stage 3: no start ended with the conditions kept; smallest margin "
                f"{max(one.margin for one in results):.1e}, moduli to be held missed by "
                f"{min(one.departure for one in results):.1e} or more"
            )
        lowest = min(reached.loss for reached in kept)
        # Equal losses are one optimum: the first start is kept, whatever the rounding.
        return next(reached for reached in kept if reached.loss <= lowest * (1 + SAME_LOSS))

    def worse(self, found: LPSFound, method: GaussNewton) -> bool:
        """Whether local elasticity of held moduli explains the displacement better."""
        large = any(np.count_nonzero(each.interior) > MOST_NODES for each in self.sets)
        if large or not (self.flat and isinstance(method.moduli, tuple)):
            return False
        model, errors = self.model(found), np.zeros(2)
        for each, made in zip(self.sets, self.products):
            stencil = model.stencil(h := each.spacing)
            own, C = displacement_error(stencil, each, made.least), stencil.elastic / h**2
            local = (Stencil(h, *difference_tensors(C, reach)) for reach in REACHES)
            tried = (displacement_error(stencil, each) for stencil in local)
            errors += len(each) * np.array([own, next(filter(np.isfinite, tried), np.inf)])
        return bool(errors[0] > errors[1])

    def check(self, final: LPSFound, loss: str) -> float:
        """Check rows against the operator (RuntimeError where residuals differ) and the loss
        (InputError where no less than without a model); warn of a modulus on its lower bound.
        Returns the largest ‖L u − b‖/‖b‖ of a set."""
        left = self.left(final)
        size = math.sqrt(np.concatenate(self.weights) @ np.concatenate(left) ** 2)
        of_rows = squares(self.rows("residual"), self.lattices, self.model(final))
        apart = abs(math.sqrt(of_rows) - size)
        if not apart <= ERROR_TOLERANCE * size + ROUNDING:
            raise RuntimeError(
                f"the residual by rows departs from the operator's by {apart:.1e} of {size:.1e}"
            )
        if final.losses and not final.loss < 1:
            what = "displacements" if loss == "output" else "loads"
            raise InputError(
                f"u, b: the best model leaves {100 * math.sqrt(final.loss):.4g} % of the {what}, "
                "no less than no model: they do not belong together, or noise drowns them"
            )
        printed = isinstance(self.law.method, TwoStage)
        bound = SMALLEST_MODULUS * self.unit if printed else HEADROOM * self.zeta
        ended = {"μ": final.solid.mu, "λ + μ": final.solid.lam + final.solid.mu}
        low = [name for name, value in ended.items() if value <= bound * (1 + ON_BOUND)]
        if low:
            unit = symbols(self.sets[0].units)[1]
            warn(
                f"{' and '.join(low)} ended on the lower bound, {bound:.3g} {unit}, "
                f"where the data show a stiffness of {self.stiffness:.3g} {unit}: they do not "
                "determine it, or ask for less"
            )
        return max(relative(r, one.b) for r, one in zip(left, self.products))

    def certified(self, final: LPSFound, done: LPS, choice: LossSelection) -> Fit:
        """The fit, its model with a certificate on every training lattice."""
        sets, bare = self.sets, self.model(final)
        proofs = [certify(bare, spacing=s.spacing, points=s if self.flat else None) for s in sets]
        printed = self.conditions.kind == "paper"
        good = (proof for proof in proofs if proof.holds and (not printed or proof.paper))
        zeta = {"zeta": self.zeta, "stiffness of the data": self.stiffness}
        provenance: Any = {"zeta": zeta}
        if final.shape is not None:
            _, departure = final.shape.coefficients(self.lengths, self.law.horizon)
            provenance["influence"] = final.shape.record(departure)
        if self.degrees:
            errors = {f"{M}": error for M, error in self.degrees.items()}
            provenance["degree"] = {"error on loads left out": errors}
        model = replace(
            bare,
            trained_on=tuple(points.spacing for points in sets),
            certified_on=tuple(proof.spacing for proof in good),
            trained_strain=max(largest_strain(points, points.u) for points in sets),
            largest_wave_number=max(largest_wave_number(points) or 0.0 for points in sets) or None,
            certificate={f"{proof.spacing:g}": proof.figures() for proof in proofs},
            provenance=provenance,
            versions={"python": platform.python_version(), "warp_peri": __version__}
            | {name: version(name) for name in ("warp-lang", "torch", "numpy", "scipy")},
        )
        return Fit(
            model,
            proofs[0],
            {"E_res": self.history[-1].E_res_train},
            self.history,
            done,
            choice,
            [moduli(model, classes) for classes in self.lattices],
            self.starts,
            self.degrees,
            final.shape,
        )


PROBED_HORIZON = 2.0
"""Horizon in spacings of the bond-based solid that a lattice's stiffness is measured with."""


def stiffness_of(sets: Sequence[Samples], horizon: float) -> float:
    """Stiffness that loads and displacements on lattices show together [TPa]: that of the
    bond-based solid, K = 1/r, of equal work, ‖b‖² over b·A u, A of unit stiffness, where noise in u
    averages out. Raises InputError where it is not above zero."""
    loads = work = 0.0
    for samples in sets:
        near = min(PROBED_HORIZON * samples.spacing, horizon)
        bonds = Bonds(samples.points, near, bond_based=True)
        force = bonds.law(1.0, 1.0, 1.0, 1.0).force(samples.u.reshape(len(samples.u), -1))[0]
        b = samples.loads[:, samples.interior].reshape(force.shape)
        loads, work = loads + (b**2).sum(), work + (force * b).sum()
    if not work > 0:
        raise InputError(
            "u, b: loads and displacements do work of opposite sign, or none, and no solid answers "
            "loads so; expected b to be the load, which is minus the internal force"
        )
    return float(loads / work)


def displacement_error(stencil: Stencil, samples: Samples, least: int | None = None) -> float:
    """Mean relative error of the displacement that a stencil answers the loads with (theory, 31),
    infinite where bonds reach beyond the collar, or it has no stable answer."""
    try:
        grid = grid_of(samples.points, stencil.steps, least=least)
    except InputError:
        return np.inf
    there, nodes = np.zeros(grid.shape, bool), grid.near[np.argsort(grid.place)]
    there.flat[grid.place] = True
    u, b = (one[:, nodes] @ grid.axes for one in (samples.u, samples.loads))
    b = (b - grid.periodic * b.mean(axis=1, keepdims=True)).reshape(len(u), -1)
    inside = samples.interior[nodes]
    unknown = np.repeat(inside, stencil.dimension)
    unknown[: stencil.dimension * grid.periodic] = False  # a node holds a period
    L = block(stencil, there, around=grid.periodic)[unknown]
    if (factors := definite_factors(L[:, unknown])) is None:
        return np.inf
    found = u.reshape(b.shape).copy()
    found[:, unknown] = factors.solve(b[:, unknown].T - L[:, ~unknown] @ found[:, ~unknown].T).T
    size, wrong = (sizes(one, inside) for one in (u, found.reshape(u.shape) - u))
    return float(np.mean(wrong / np.where(size > 0, size, np.inf)))
