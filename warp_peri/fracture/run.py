"""A run of many steps: ledger and histories on the way, fields for ParaView, and going on again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.files.checkpoint import AllNodes, agreed, fingerprint
from warp_peri.fracture.body import HAIR, section
from warp_peri.fracture.dynamics import BreakingBody, BreakingState, step
from warp_peri.points.arguments import Positive, checked
from warp_peri.solvers.motion import Motion, Recorder

NODAL = ("u", "v", "force", "energy", "work")
"""Arrays of a state that a checkpoint holds for each node."""
LEDGER = ("time", "work", "kinetic", "elastic", "dissipated")


class Broken(NamedTuple):
    """How a motion has ended: φ, the share of bonds that a node has lost, [N]; body and state."""

    damage: np.ndarray
    body: BreakingBody
    state: BreakingState


class Section:
    """The bonds across a straight line, to sum the force that they carry.

    Args:
        body: the body in motion.
        line: two ends, shape [2, 2]; in space the corners of a flat polygon, [P, 3].
        own: the nodes whose bonds are summed here.

    Raises InputError for a line of another shape.
    """

    def __init__(self, body: BreakingBody, line: ArrayLike, own: Any) -> None:
        cut, self.ends, normal = section(body.body, line, "section")
        node, bond = np.nonzero(cut)
        here = np.zeros(len(cut), bool)
        here[own] = True
        height = (body.body.x[node] - self.ends[0]) @ normal
        left = here[node] & (height > -HAIR / 2 * body.body.spacing)  # those on it stand there
        self.count = int(here[node].sum())
        self._node, self._bond, self._owner = node[left], bond[left], body

    def carried(self, state: BreakingState) -> np.ndarray:
        """Force density of each bond across the line, shape [E, d]."""
        owner, node, bond = self._owner, self._node, self._bond
        body, (stiffness, share, excess) = owner.body, owner.operator.bonded
        far, kept = body.neighbour[node, bond], owner.operator.kept(state.links, node, bond)
        u, xi = state.u.numpy(), body.xi[bond]
        e = (xi * (u[far] - u[node])).sum(axis=1)
        pull = 2 * stiffness[bond] * e
        if excess != 0:
            theta = owner.operator.dilatation(node) + owner.operator.dilatation(far)
            pull = pull + excess * share[bond] * theta
        return np.asarray((pull * kept)[:, None] * xi)


class CrackRun(Recorder):
    """Marches a body, and goes on from its checkpoint with the same bits.

    On ranks the body is that of some nodes, and all records are of the whole body.

    Args:
        body: the body; on ranks of the nodes here.
        step: Δt, at most the body's longest.
        regions: own nodes whose mean displacement and velocity are recorded, [n] bool by name.
        watch: functions of φ [N], the share of bonds that nodes have lost, recorded by name.
        sections: lines across which the force is recorded, [2, 2] by name; in space polygons.
        nodes: which of the body's are this process's own, as AllNodes; all by default.
        files: the options of Recorder; `every` is 20 by default.

    Attributes:
        history: of each record by name: those of LEDGER, "u NAME" and "v NAME" of regions,
            "force NAME" across sections, per thickness on the side that lies to the left of the
            line, and what is watched.

    Raises InputError for a step or counts that are not > 0 or too long, for regions without nodes,
    and for sections without bonds.
    """

    kind = "warp_peri.crack"

    def __init__(
        self,
        body: BreakingBody,
        *,
        step: Positive,
        regions: Mapping[str, ArrayLike] | None = None,
        watch: Mapping[str, Callable[[np.ndarray], Any]] | None = None,
        sections: Mapping[str, ArrayLike] | None = None,
        nodes: Any = None,
        **files: Any,
    ) -> None:
        nodes = AllNodes(len(body.body.x)) if nodes is None else nodes
        x, comm = body.body.x[nodes.own], nodes.comm
        super().__init__(nodes, x, **{"every": 20} | files)
        with agreed(comm):
            if not step <= body.longest_step:
                raise InputError(
                    f"step: expected at most {body.longest_step:.6g}, the longest that is stable "
                    f"whatever breaks, got {step:.6g}"
                )
            self.watch: dict[str, Any] = dict(watch or {})
            if not all(map(callable, self.watch.values())) or {*LEDGER} & {*self.watch}:
                raise InputError(
                    f"watch: expected functions by name, none of {', '.join(LEDGER)}, got "
                    f"{watch!r:.50}"
                )
            self.regions = {
                name: checked(f"region {name}", mask, bool, (len(x),))
                for name, mask in (regions or {}).items()
            }
            self.sections = {
                name: Section(body, line, nodes.own) for name, line in (sections or {}).items()
            }
        counts = {f"region {name}": int(mask.sum()) for name, mask in self.regions.items()}
        counts |= {f"section {name}": one.count for name, one in self.sections.items()}
        self._size = {name: comm.allreduce(count) for name, count in counts.items()}
        if empty := [name for name, size in self._size.items() if not size]:
            raise InputError(f"{empty[0]}: expected nodes, or a line that bonds cross, got none")
        self.body, self.dt, self.shares = body, float(step), list[float]()
        self.history = {name: [] for name in LEDGER}

    def motion(self, state: BreakingState) -> Motion:
        """What has been recorded, with the end at the nodes of this process."""
        own, (time, history) = self.nodes.own, self.recorded()
        u, v = (field.numpy()[own].copy() for field in (state.u, state.v))
        broken = Broken(self.body.damage(state)[own], self.body, state)
        return Motion(time, u, v, history, broken)

    def advance(self, state: BreakingState) -> BreakingState:
        return step(self.body, state, self.dt)

    def record(self, state: BreakingState) -> tuple[float, dict[str, Any], dict[str, Any]]:
        body, nodes = self.body, self.nodes
        found: dict[str, Any] = dict(zip(LEDGER, body.ledger(state, nodes)))
        for name, mask in self.regions.items():
            for kind, field in (("u", state.u), ("v", state.v)):
                total = nodes.sum(field.numpy()[nodes.own][mask])
                found[f"{kind} {name}"] = total / self._size[f"region {name}"]
        cell = body.body.spacing**body.body.dimension
        for name, across in self.sections.items():
            found[f"force {name}"] = cell * nodes.sum(across.carried(state))
        if not (self.watch or self.series):
            return state.time, found, {}
        phi = body.damage(state)[nodes.own]
        if self.watch:
            everywhere = nodes.gather(phi)
            found |= {name: function(everywhere) for name, function in self.watch.items()}
        return state.time, found, {"damage": phi}

    def nodal(self, state: BreakingState) -> dict[str, np.ndarray]:
        """`left`: bonds of the ball that each node has, [m, B]."""
        arrays = {name: getattr(state, name).numpy() for name in NODAL}
        left = self.body.operator.kept(state.links).astype(np.uint8)
        return arrays | {"dissipated": state.dissipated, "whole": state.whole, "left": left}

    def _times(self, steps: int) -> list[float]:
        """After each of so many steps, as they add up."""
        return np.cumsum(np.full(steps, self.dt)).tolist()  # type: ignore[no-any-return]

    def key(self, steps: int) -> dict[str, str]:
        body, nodes, lines = self.body, self.nodes, [one.ends for one in self.sections.values()]
        masks = [nodes.gather(mask) for mask in self.regions.values()]
        names = list(self.sections), list(self.regions), self.watch
        fields = {name: getattr(body, name).numpy() for name in ("load", "held", "grip")}
        fields |= {"nodes": body.body.x, "no_fail": body.no_fail}
        self.shares += map(body.share, self._times(steps)[len(self.shares) :])
        return {name: nodes.mark(field) for name, field in fields.items()} | {
            "solid": fingerprint(body.solid, body.operator.limits, body.corrected),
            "load history": fingerprint(self.shares[:steps]),
            "step": fingerprint(self.dt),
            "records": fingerprint(self.every, names, lines, masks),
        }

    def restored(
        self, state: BreakingState, arrays: dict[str, np.ndarray], steps: int
    ) -> BreakingState:
        for name in NODAL:
            getattr(state, name).numpy()[:] = arrays[name]
        left = np.where(arrays["left"], self.body.body.neighbour, -1)
        state.links, state.correction = self.body.links_of(left)
        state.dissipated[:], state.whole = arrays["dissipated"], arrays["whole"]
        state.time, state.steps = self._times(steps)[-1], steps
        return state
