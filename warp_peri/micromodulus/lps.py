"""Linear peridynamic solids as micromodulus tensors of twice their range (theory.md, T17)."""

from __future__ import annotations

from warp_peri.core.groups import LATTICE_GROUP
from warp_peri.errors import InputError
from warp_peri.lps.model import Model, lps_stencil
from warp_peri.micromodulus.law import Crystal


def tensors_of(model: Model, spacing: float) -> Crystal:
    """The law of an LPS, with one influence function or two, on a lattice, exactly.

    C(ξ) is minus its stencil at ξ: products of dilatations make bonds of range 2δ. Any points whose
    families are whole give the same force. Of a solid in space it is what is proven,
    and solved where nodes are many.

    Args:
        model: linear.
        spacing: of the lattice, in the model's units.

    Raises InputError for what is no linear peridynamic solid, and a spacing without bonds.
    """
    if not isinstance(model, Model):
        raise InputError(f"model: expected a linear peridynamic solid, got {type(model).__name__}")
    stencil = lps_stencil(model, spacing)
    law = Crystal(
        spacing, stencil.steps, stencil.tensors, model.units, LATTICE_GROUP[model.dimension],
        provenance={"fit": {"from": "linear peridynamic solid"}},
    )  # fmt: skip
    return law.certified()
