"""Coarse graining on the page on You et al. (2021): forces between nodes, horizon, smoothing."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from tools.graphene import bond_length
from tools.lammps_session import LammpsSession
from tools.loads import TRAINING
from tools.make_graphene import graphene_bodies, solve_all
from tools.statics import ColouredHessian, find_bonds
from warp_peri.atoms import smoothing_matrix

RADIUS, SPACING = 10.0, 5.0
LOAD = 7
"""Of training, whose forces between nodes are shown."""
BEYOND = (10.0, 15.0, 20.0)


def forces_between_nodes(cache: Path) -> dict[str, Any]:
    """f(y, x) of (2.8) by distance, under one training load, of atoms made linear at rest.

    A pair of atoms pulls by −H (U′ − U), H the block of the energy's Hessian.
    """
    body = graphene_bodies()[0]
    (sample,) = solve_all({body: [TRAINING[LOAD]]}, cache, 1, False)[body]
    X, U, atoms = sample.reference, sample.displacement, len(sample.reference)
    with LammpsSession(X, box=body.box, potential=body.potential) as session:
        hessian = ColouredHessian(find_bonds(X, body.box), atoms)(session.forces, X)
    blocks = sp.bsr_array(sp.csr_array(hessian), blocksize=(2, 2))
    first = np.repeat(np.arange(atoms), np.diff(blocks.indptr))
    pull = -np.einsum("nij,nj->ni", blocks.data, U[blocks.indices] - U[first])
    apart = X[blocks.indices] - X[first]
    apart -= np.array(body.box) * np.rint(apart / body.box)
    line = SPACING * np.arange(-9, 10)
    nodes = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    inner = np.abs(nodes).max(axis=1) <= 20.0  # whose partners, to 25 Å, are all among the nodes
    omega = smoothing_matrix(X, nodes, radius=RADIUS, box=body.box, spacing=SPACING)
    parts = [
        (
            omega[inner]
            @ sp.csr_array((pull[:, c], (first, blocks.indices)), (atoms, atoms))
            @ omega.T
        )
        for c in (0, 1)
    ]
    f = np.stack([part.toarray() for part in parts], axis=-1)
    size = np.linalg.norm(f, axis=2)
    distance = np.linalg.norm(nodes[None] - nodes[inner][:, None], axis=2)
    balance = f.sum(axis=1) + omega[inner] @ sample.force
    there = size > 1e-12 * size.max()
    return {
        "share": [float(size[distance > r].sum() / size.sum()) for r in BEYOND],
        "farthest": float(distance[there].max()),
        "atoms": float(np.linalg.norm(apart, axis=1).max()),
        "left": float(np.linalg.norm(balance) / np.linalg.norm(omega[inner] @ sample.force)),
        "bond": bond_length(body.potential),
    }


def rows(found: Mapping[str, Any], change: Mapping[str, float]) -> list[list[str]]:
    """What is printed of smoothing and its horizon, and what is measured."""
    shares = [
        [f"part of Σ‖f(y, x)‖ beyond {r:g} Å", "–", f"{100 * share:.2g} %"]
        for r, share in zip(BEYOND, found["share"])
    ]
    reach, bond = 2 * RADIUS + found["atoms"], found["bond"]
    return [
        ["δ = 2R + d", f"{2 * RADIUS + 1.46:.2f} Å, d = 1.46 Å the bond", f"{reach:.2f} Å"],
        ["bond; farthest atoms that pull", "1.46 Å; –", f"{bond:.4f} Å; {found['atoms']:.2f} Å"],
        ["farthest nodes that pull", "–", f"{found['farthest']:.2f} Å"],
        *shares,
        ["u by a paraboloid: longest wave", "about 0.3 %", f"{100 * change['longest_wave']:.2f} %"],
        ["mean over training", "–", f"{100 * change['training_mean']:.1f} %"],
        ["largest", "–", f"{100 * change['largest']:.0f} %"],
    ]
