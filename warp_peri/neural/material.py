"""The peridynamic neural operator as a material: two networks, their scales and their units."""

from __future__ import annotations

import copy
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from warp_peri.errors import InputError
from warp_peri.neural.bonds import NetworkBonds
from warp_peri.neural.networks import evaluate, network
from warp_peri.points.arrays import check_positive, is_positive
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.points.unit_names import USUAL, Units, check_same, check_units, factors, symbols
from warp_peri.shown import Shown

if TYPE_CHECKING:  # the operator stands above its numbers
    from warp_peri.neural.at_rest import AtRest
    from warp_peri.neural.training import NeuralFit, Training
    from warp_peri.points.samples import Samples

STRAIN = 0.1
"""Extensions and dilatations are counted in this strain as the networks' inputs."""
WIDEST = 10_000
"""Numbers of a hidden layer at most."""
COUNT = 201
"""Points of an exported curve."""


@dataclass(frozen=True)
class Curves:
    """Influence and scalar force state as they were learned, for drawing and for other programs.

    Attributes:
        xi: bond vectors [length], shape [n, 2].
        omega: ω(ξ), shape [n].
        stretch: e/|ξ|, shape [m].
        state: t [stress/length³] of the bonds `lengths` at these stretches, without dilatation,
            shape [k, m].
        lengths: |ξ| [length], shape [k].
    """

    xi: np.ndarray
    omega: np.ndarray
    stretch: np.ndarray
    state: np.ndarray
    lengths: np.ndarray


class NeuralOperator(Shown, torch.nn.Module):
    """ω as a network of the bond, the scalar force state as one of (ω, ϑ, e, |ξ|), (NO1)–(NO4).

    Args:
        horizon: δ [length].
        influence: widths of the two hidden layers of ω.
        state: of the force state.
        anisotropic: ω is a function of ξ/δ, (NO2), instead of |ξ|/δ.
        proportional: the force state is the network times e, (NO5).
        strain: the scale of the networks' inputs ϑ and e/|ξ|.
        units: of length and stress.
        seed: of the first numbers.

    Attributes:
        scale: s of (NO4) [stress/length³].
        widths: of both networks' hidden layers.
        provenance: how the numbers were learned.

    Numbers are float32 until `.double()` is called, and forces are computed in their precision.

    Raises InputError for a horizon, a strain or widths that are none.
    """

    dimension = 2

    def __init__(
        self,
        horizon: float,
        influence: Sequence[int] = (256, 512),
        state: Sequence[int] = (512, 512),
        *,
        anisotropic: bool = False,
        proportional: bool = False,
        strain: float = STRAIN,
        units: Units = USUAL,
        seed: int = 0,
    ) -> None:
        super().__init__()
        check_positive("horizon", horizon)
        check_positive("strain", strain)
        for name, widths in (("influence", influence), ("state", state)):
            whole = np.shape(widths) == (2,) and all(is_positive(w) and w % 1 == 0 for w in widths)
            if not (whole and max(widths) <= WIDEST):
                raise InputError(
                    f"{name}: expected two whole numbers from 1 to {WIDEST}, got {widths!r:.60}"
                )
        self.horizon, self.strain, self.units = float(horizon), float(strain), check_units(units)
        self.anisotropic, self.proportional = bool(anisotropic), bool(proportional)
        self.scale = 1.0
        self.provenance: dict[str, Any] = {}
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.influence = network(2 if anisotropic else 1, *map(int, influence), 1)
            self.state = network(4, *map(int, state), 1)
        self.widths = {"influence": _pair(influence), "state": _pair(state)}
        if proportional:  # near springs, so that the first equilibria exist
            torch.nn.init.ones_(next(reversed(list(self.state.parameters()))))

    def omega(self, xi: torch.Tensor) -> torch.Tensor:
        """ω of bonds, shape [n], from ξ [length], shape [n, 2]: (NO1) or (NO2)."""
        inputs = xi if self.anisotropic else xi.norm(dim=1, keepdim=True)
        value: torch.Tensor = self.influence(inputs / self.horizon)[:, 0]
        return value

    def force_state(
        self, omega: torch.Tensor, theta: torch.Tensor, e: torch.Tensor, r: torch.Tensor
    ) -> torch.Tensor:
        """t [stress/length³] of bonds (NO4), all of shape [n]; those alike lie together."""
        extension = e / (self.strain * r)
        inputs = torch.stack([omega, theta / self.strain, extension, r / self.horizon], dim=1)
        value = self.scale * evaluate(self.state, inputs)
        return value * extension if self.proportional else value

    def on(self, points: PointsLike) -> AtRest:
        """The operator on the nodes of a lattice.

        Raises InputError for scattered points, an interior without its 2δ collar, or other units.
        """
        from warp_peri.neural.at_rest import AtRest

        check_same(self.units, nodes_of(points).units)
        return AtRest(self, NetworkBonds(points, self.horizon))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a JSON file with the weights in it; see file.save for their precision."""
        from warp_peri.neural.file import save

        save(self, path)

    def learn(
        self,
        samples: Samples,
        *,
        validation: Samples,
        training: Training | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        progress: bool = True,
    ) -> NeuralFit:
        """Train a copy of these networks; arguments and errors as of training.train."""
        from warp_peri.neural.training import NeuralFit, Training, train

        material = copy.deepcopy(self)
        asked = Training() if training is None else training
        if not isinstance(asked, Training):
            raise InputError(f"training: expected Training(…), got {asked!r:.60}")
        history = train(
            material, samples, validation, asked, checkpoint=checkpoint, progress=progress
        )
        return NeuralFit(material, history)

    def fitted(self, forces: torch.Tensor, loads: torch.Tensor) -> None:
        """Scale the force state so that forces are as large as loads: where training starts."""
        size = float(forces.detach().norm())
        if size > 0:
            self.scale *= float(loads.norm()) / size

    def in_units(self, units: Units) -> NeuralOperator:
        """The same material in other units."""
        length, stress = factors(self.units, units)
        other = copy.deepcopy(self)
        other.units, other.horizon = check_units(units), self.horizon * length
        other.scale = self.scale * stress / length**3
        return other

    def curves(self, *, strain: float | None = None, lengths: int = 4) -> Curves:
        """Influence over the horizon and force state over the stretch, at some bond lengths.

        Args:
            strain: largest stretch; the networks' own scale where none is given.
            lengths: number of bond lengths, evenly up to δ.

        Raises InputError for a stretch that is none, and lengths below 1.
        """
        check_positive("strain", self.strain if strain is None else strain)
        check_positive("lengths", lengths)
        line = torch.linspace(0, self.horizon, COUNT + 1, dtype=torch.float64)[1:]
        grid = torch.cat([-line.flip(0), line])
        exact = copy.deepcopy(self).double()
        if self.anisotropic:
            xi = torch.cartesian_prod(grid[::4], grid[::4])
            xi = xi[xi.norm(dim=1) <= self.horizon]
        else:
            xi = torch.stack([line, torch.zeros_like(line)], dim=1)
        most = self.strain if strain is None else strain
        stretch = torch.linspace(-most, most, COUNT, dtype=torch.float64)
        r = self.horizon * torch.arange(1, lengths + 1, dtype=torch.float64) / lengths
        with torch.no_grad():
            along = torch.stack([r, torch.zeros_like(r)], dim=1)
            omega = exact.omega(along).repeat_interleave(COUNT)
            wide = r.repeat_interleave(COUNT)
            e = wide * stretch.repeat(lengths)
            state = exact.force_state(omega, torch.zeros_like(e), e, wide).reshape(lengths, COUNT)
            found = exact.omega(xi)
        arrays = (part.numpy() for part in (xi, found, stretch, state, r))
        return Curves(*arrays)

    def content(self) -> dict[str, Any]:
        """Everything but the weights, as it stands in a file."""
        return {
            "horizon": self.horizon,
            "influence": list(self.widths["influence"]),
            "state": list(self.widths["state"]),
            "anisotropic": self.anisotropic,
            "proportional": self.proportional,
            "strain": self.strain,
            "scale": self.scale,
            "length_unit": self.units[0],
            "stress_unit": self.units[1],
            "provenance": self.provenance,
        }

    def numbers(self) -> int:
        """How many numbers are learned."""
        return sum(part.numel() for part in self.parameters())

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value."""
        length, stress = symbols(self.units)
        first = "ω(ξ)" if self.anisotropic else "ω(|ξ|)"
        widths = ", ".join(f"{key} {pair}" for key, pair in self.widths.items())
        learned = f"epoch {self.provenance['best']}" if "best" in self.provenance else "not said"
        return [
            ("horizon", f"{self.horizon:g} {length}, in {length} and {stress}"),
            ("form", first + (", force state in proportion to e" if self.proportional else "")),
            ("numbers", f"{self.numbers()}; {widths}"),
            ("learned", learned),
        ]


def _pair(widths: Sequence[int]) -> tuple[int, int]:
    """Widths of two hidden layers."""
    first, second = widths
    return int(first), int(second)
