"""What the file of a learned law of flow holds: `warp_peri.flow_law`, version 1."""

from __future__ import annotations

from typing import Any

from warp_peri.flow.gaussian_process import GaussianProcess

FORMAT, VERSION = "warp_peri.flow_law", 1
UNITS = {"time": "relaxation time", "stress": "n k T", "conformation": "<q q> of a Hookean at rest"}


def law_content(
    kind: str,
    processes: tuple[GaussianProcess, ...],
    outside: str,
    provenance: dict[str, Any],
    *,
    kinematics: bool | None = None,
    b: float | None = None,
) -> dict[str, Any]:
    """The content, by what the law is made of; its units are reduced ones."""
    content = {"format": FORMAT, "version": VERSION, "kind": kind, "units": UNITS}
    content |= {"outside": outside, "kinematics": kinematics, "b": b, "provenance": provenance}
    names = GaussianProcess.__dataclass_fields__
    return content | {"processes": [{n: getattr(p, n) for n in names} for p in processes]}
