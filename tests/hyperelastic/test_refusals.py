"""What makes no sheet, and what nothing can be learned from."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import warp_peri as wp
from tests.support.sheets import hgo_dictionary, sheet_on, square, waves
from warp_peri.hyperelastic import EnergyTerm, Hyperelastic, HyperelasticMaterial, ThicknessField
from warp_peri.materials.hyperelastic.model_selection import febio_material

POINTS, HGO = square(4), hgo_dictionary()
FRAMES = wp.Samples(POINTS, np.stack([waves(POINTS, 0.3, seed) for seed in range(3)]))
LOADS = wp.Samples(POINTS, FRAMES.u, np.ones_like(FRAMES.u))
AFFINE = np.stack([0.1 * POINTS.x, POINTS.x @ [[0.2, 0.1], [0.0, 0.3]]])
ALL, FEW = np.ones(len(POINTS.x), bool), POINTS.interior.copy()
FEW[np.flatnonzero(FEW)[3:]] = False
TWO_MATRICES = tuple(map(EnergyTerm, ("neo_hookean", "plane_stress")))


def solid(dictionary, count=None):
    return HyperelasticMaterial(dictionary, np.ones(count or len(dictionary)), 0.1)


def fit(samples=FRAMES, u=None, **options):
    samples = samples if u is None else wp.Samples(samples.points, u)
    return partial(wp.fit, samples, HGO, **options)


REFUSED = {
    "kind: expected one of": lambda: EnergyTerm("ogden"),
    "fibre_power: expected an exponent": lambda: EnergyTerm("fibre_power", 0.0, 1.0),
    "bonds of a half family": lambda: Hyperelastic(3.0, ((-1, 0),)),
    "at least one energy": Hyperelastic,
    "coefficients: expected finite values, got nan": lambda: replace(
        solid(HGO), coefficients=np.full(7, np.nan)
    ),
    "coefficients: expected 7 numbers": lambda: solid(HGO, 6),
    "twice the horizon": lambda: sheet_on(wp.Points(POINTS.x, ALL, 0.1)),
    "spacing|scattered": lambda: sheet_on(wp.Points(POINTS.x, ALL, 0.0)),
    "axis: directions of a hyperelastic": lambda: sheet_on(replace(POINTS, axis=10.0)),
    "thickness: expected shape": lambda: sheet_on(POINTS, thickness=np.ones(3)),
    "thickness: expected finite numbers > 0": lambda: sheet_on(POINTS, thickness=0 * ALL),
    "degree: expected 1 to 6": lambda: ThicknessField.over(POINTS.x, 7),
    r"numbers: expected shape \[5\]": lambda: replace(
        ThicknessField.over(POINTS.x, 2), numbers=np.ones(4)
    ),
    "expected neo_hookean and volumetric": lambda: febio_material(
        solid(Hyperelastic(terms=TWO_MATRICES))
    ),
    "stretches: expected such": lambda: wp.hyperelastic.uniaxial_stress(solid(HGO), [0.1]),
    "a load on it, got none in number 0; without": fit(wp.Samples(POINTS, FRAMES.u, 0 * FRAMES.u)),
    "expected one or more, .* got no sample": fit(LOADS[:0]),
    "a displacement of it, got none in number 1": fit(u=FRAMES.u * [[[1]], [[0]], [[1]]]),
    "stiffness: expected a number ≥ 0": fit(LOADS, stiffness=-1.0),
    "options among positive, .*, got rigde": fit(LOADS, rigde=0.0),
    "a homogeneous body of any material": fit(u=AFFINE),
    r"expected strains of 2 % or more in one, got [01]\.\d": fit(u=0.05 * FRAMES.u),
    "70 measured components inside for 7 numbers, got 18": fit(
        wp.Samples(replace(POINTS, interior=FEW), FRAMES.u)
    ),
    "start: expected 7 coefficients": fit(start=np.ones(2)),
    "50 interior nodes for 5 numbers, got 16": partial(
        wp.hyperelastic.select_model, FRAMES[[0] * 4]
    ),
    "frames: expected at least 4, got 3": partial(wp.hyperelastic.select_model, FRAMES),
}


def test_what_makes_no_sheet_and_what_tells_nothing_is_refused():
    for words, call in REFUSED.items():
        with pytest.raises(wp.InputError, match=words):
            call()
