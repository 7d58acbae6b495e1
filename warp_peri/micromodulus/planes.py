"""Plane problems of a crystal in space, as laws in the plane (theory.md, T6)."""

from __future__ import annotations

import numpy as np

from warp_peri.core import elastic
from warp_peri.core.groups import point_group
from warp_peri.errors import InputError
from warp_peri.micromodulus.law import BROKEN, Crystal
from warp_peri.micromodulus.waves import fit_symbol


def plane_strain(law: Crystal, normal: int = 2) -> Crystal:
    """The law of fields that do not change along an axis of the nodes: bonds summed along it.

    Exactly what the law in space does with such fields, at all wavelengths.

    Args:
        law: in space.
        normal: axis of the nodes, 0, 1 or 2.

    Raises InputError for a law in the plane, another axis, and a crystal that such fields push out
    of the plane: a mirror or a twofold turn about the normal forbids it.
    """
    kept = _kept(law, normal)
    sums: dict[tuple[int, ...], np.ndarray] = {}
    for step, C in zip(law.steps[:, kept].tolist(), law.tensors):
        if any(step):
            key = max(tuple(step), tuple(-s for s in step))
            sums[key] = sums.get(key, np.zeros((3, 3))) + C
    tensors = np.array(list(sums.values()))
    pushed = np.abs(tensors[:, kept, normal]).max()
    if pushed > BROKEN * np.abs(tensors).max():
        raise InputError(
            f"normal: expected an axis with a mirror or a twofold turn, got one along which fields "
            f"of the plane push (by {pushed / np.abs(tensors).max():.1e} of the tensors)"
        )
    turns = law.orientation @ point_group(law.symmetry, 3) @ law.orientation.T
    turns = turns[np.abs(np.abs(turns[:, normal, normal]) - 1) < BROKEN][:, kept][:, :, kept]
    flat = Crystal(
        law.spacing,
        np.array(list(sums)),
        tensors[:, kept][:, :, kept],
        law.units,
        turns,
        provenance=law.provenance,
        stress=None if law.stress is None else law.stress[np.ix_(kept, kept)],
    )
    return flat.certified()


def plane_stress(law: Crystal, normal: int = 2) -> Crystal:
    """The law of a thin sheet of a crystal in space, free of stress across an axis of its nodes.

    Its moduli are a Schur complement; at short waves it answers as that elastic solid does, for
    what a sheet's faces do there is no property of the crystal. Bonds are those of `plane_strain`.

    Raises InputError as `plane_strain` does.
    """
    kept = _kept(law, normal)
    order = [*kept, normal]
    C = elastic.plane_stress(law.tensor()[np.ix_(order, order, order, order)])
    brackets = elastic.brackets_from_elastic(C)
    flat = plane_strain(law, normal)
    return fit_symbol(
        lambda k: elastic.acoustic(brackets, k),
        law.spacing,
        flat.horizon,
        symmetry=flat.symmetry,
        tensor=C,
        units=law.units,
        record={"from": "plane stress"},
    )


def _kept(law: Crystal, normal: int) -> list[int]:
    if law.dimension != 3 or normal not in (0, 1, 2):
        raise InputError(
            f"normal: expected axis 0, 1 or 2 of a law in space, got {normal!r:.20} of one in "
            f"{law.dimension} dimensions"
        )
    return [axis for axis in range(3) if axis != normal]
