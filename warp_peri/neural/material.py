"""The peridynamic neural operator: its networks, material and file."""

from __future__ import annotations

import base64
import copy
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from warp_peri.core import record
from warp_peri.core.record import Length
from warp_peri.errors import InputError, Rows, Shape, Shown, StrPath, Values
from warp_peri.files import atomic
from warp_peri.neural.placed import Placed, check_precision
from warp_peri.neural.training import NeuralFit, TrainingSettings, train
from warp_peri.points.arguments import (
    USUAL,
    Positive,
    Seed,
    Units,
    check_same,
    check_units,
    checked,
    factors,
    is_positive,
    symbols,
    typed,
)
from warp_peri.points.points import PointsLike, Samples, nodes_of


def network(*widths: int) -> torch.nn.Sequential:
    """Make a network of linear layers with rectifiers between them."""
    layers = []
    for width, following in itertools.pairwise(widths):
        layers += [torch.nn.Linear(width, following), torch.nn.ReLU()]
    return torch.nn.Sequential(*layers[:-1])


STRAIN = 0.1
"""Extensions and dilatations are counted in this strain as the networks' inputs."""
WIDEST = 10_000
"""Numbers of a hidden layer at most."""
LARGEST_SCALE = 1e30
"""Of force states over the horizon, in float32."""
CHUNK = 2048
"""Bonds at once: their hidden layers stay in a processor's cache."""


@typed
class NeuralOperator(Shown, torch.nn.Module):
    """Neural material with networks ω(ξ) and force state t(ω, ϑ, e, |ξ|), (NO1)–(NO4).

    Args:
        horizon: δ [length].
        influence: widths of the two hidden layers of ω.
        state: of the force state.
        anisotropic: ω is a function of ξ/δ, (NO2), instead of |ξ|/δ.
        proportional: the force state is the network times e, (NO5).
        strain: the scale of the networks' inputs ϑ and e/|ξ|.
        units: of length and stress.
        seed: of the initial weights.

    Attributes:
        scale: s of (NO4) [stress/length³].
        widths: of both networks' hidden layers.
        provenance: how the weights were learned.

    Weights are float32 until `.double()` is called; forces and files have their precision. Raises
    InputError for an invalid horizon, strain or widths, and other precisions; training and saving
    do for networks that were replaced by others, which a file cannot tell.
    """

    dimension = 2

    def __init__(
        self,
        horizon: Positive,
        influence: Sequence[int] = (256, 512),
        state: Sequence[int] = (512, 512),
        *,
        anisotropic: bool = False,
        proportional: bool = False,
        strain: Positive = STRAIN,
        units: Units = USUAL,
        seed: Seed = 0,
    ) -> None:
        super().__init__()
        self.widths: dict[str, Shape] = {}
        for name, widths in ("influence", influence), ("state", state):
            fine = (is_positive(w) and w % 1 == 0 and w <= WIDEST for w in widths)
            if len(widths) != 2 or not all(fine):
                raise InputError(
                    f"{name}: expected two whole numbers from 1 to {WIDEST}, got {widths!r:.60}"
                )
            self.widths[name] = tuple(map(int, widths))
        self.horizon, self.strain, self.units = float(horizon), float(strain), check_units(units)
        self.anisotropic, self.proportional = anisotropic, proportional
        self.scale = 1.0
        self.provenance: Values = {}
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.influence = network(2 if anisotropic else 1, *self.widths["influence"], 1)
            self.state = network(4, *self.widths["state"], 1)
        if proportional:  # near springs, so that the first equilibria exist
            torch.nn.init.ones_(next(reversed(list(self.state.parameters()))))
        self._described = self._kinds_and_shapes()

    def _kinds_and_shapes(self) -> Any:
        """Kinds of its modules, and shapes of their weights by name."""
        return [*map(type, self.modules())], {k: w.shape for k, w in self.state_dict().items()}

    def _apply(self, fn: Any, *how: Any, **named: Any) -> Any:
        check_precision({fn(torch.empty(0)).dtype})  # before any weight is converted
        return super()._apply(fn, *how, **named)  # type: ignore[no-untyped-call]

    def omega(self, xi: torch.Tensor) -> torch.Tensor:
        """Influence function ω of bonds ξ [length], [n, 2], shape [n]: (NO1) or (NO2)."""
        inputs = xi if self.anisotropic else xi.norm(dim=1, keepdim=True)
        return torch.as_tensor(self.influence(inputs / self.horizon)[:, 0])

    def force_state(
        self, omega: torch.Tensor, theta: torch.Tensor, e: torch.Tensor, r: torch.Tensor
    ) -> torch.Tensor:
        """Force state t [stress/length³] of bonds (NO4), all of shape [n]."""
        extension = e / (self.strain * r)
        inputs = torch.stack([omega, theta / self.strain, extension, r / self.horizon], dim=1)
        value = self.scale * torch.cat([self.state(part)[:, 0] for part in inputs.split(CHUNK)])
        return value * extension if self.proportional else value

    def on(self, points: PointsLike) -> Placed:
        """Operator on the nodes of a lattice; InputError as Placed, and for other units."""
        check_same(self.units, nodes_of(points).units)
        return Placed(self, points)

    def save(self, path: StrPath) -> None:
        """Write one .json file with the weights in it, in their precision, whole or not at all.

        Raises InputError for another ending, and weights not finite or too many for a file.
        """
        if Path(path).suffix != ".json":
            raise InputError(f"{path}: expected a name that ends in .json")
        said = self.content()
        weights = {key: part.numpy() for key, part in self.state_dict().items()}
        for key, part in weights.items():
            checked(key, part)
        if (size := sum(part.nbytes for part in weights.values())) > FITS:
            raise InputError(f"{path}: expected at most {FITS} bytes of weights, got {size}")
        kind = next(iter(weights.values())).dtype.name
        coded = {key: base64.b64encode(w).decode() for key, w in weights.items()}
        NeuralFile(**said, precision=kind, weights=coded).save(path)

    @typed
    def learn(
        self,
        samples: Samples,
        *,
        validation: Samples,
        training: TrainingSettings | None = None,
        checkpoint: StrPath | None = None,
        progress: bool = True,
    ) -> NeuralFit:
        """Train a copy of these networks; arguments and errors as of training.train."""
        material, size, seen, other = copy.deepcopy(self), 1.0, samples, validation
        if samples.b is not None and validation.b is not None:  # by a power of two, for float32
            largest = np.abs(samples.b[:, samples.interior]).max(initial=0.0)
            size = math.ldexp(1.0, math.frexp(largest)[1])
            seen, other = (replace(one, b=one.loads / size) for one in (samples, validation))
        given = material, seen, other, training or TrainingSettings()
        history = train(*given, checkpoint=checkpoint, progress=progress)
        material.scale *= size
        return NeuralFit(material._precise(), history)

    def _precise(self) -> NeuralOperator:
        """Itself, in float64 where forces and slopes would go beyond float32, as in metres."""
        return self.double() if self.scale > LARGEST_SCALE * self.horizon else self

    def in_units(self, units: Units) -> NeuralOperator:
        """Convert the material to other units, in float64 where float32 would not hold forces."""
        length, stress = factors(self.units, units)
        other = copy.deepcopy(self)
        other.units, other.horizon = check_units(units), self.horizon * length
        other.scale = self.scale * stress / length**3
        return other._precise()

    def content(self) -> Values:
        """Content of the material's file without the weights; InputError for networks of other
        kinds or shapes than it describes, and for weights of other or several precisions."""
        if self._kinds_and_shapes() != self._described:
            raise InputError("networks: expected linear layers of their widths with ReLU between")
        check_precision({part.dtype for part in self.parameters()})
        return self.widths | {name: getattr(self, name) for name in SAID}

    def numbers(self) -> int:
        """Number of weights that are learned."""
        return sum(part.numel() for part in self.parameters())

    def rows(self) -> Rows:
        length, stress = symbols(self.units)
        first = "ω(ξ)" if self.anisotropic else "ω(|ξ|)"
        widths = ", ".join(f"{name} {both}" for name, both in self.widths.items())
        learned = f"epoch {self.provenance['best']}" if "best" in self.provenance else "not said"
        return [
            ("horizon", f"{self.horizon:g} {length}, in {length} and {stress}"),
            ("form", first + (", force state in proportion to e" if self.proportional else "")),
            ("numbers", f"{self.numbers()}; {widths}"),
            ("learned", learned),
        ]


SAID = "horizon", "anisotropic", "proportional", "strain", "units", "scale", "provenance"
"""Of an operator that its file says, beside widths and weights."""
PRECISIONS = {"float16": "<f2", "float32": "<f4", "float64": "<f8"}
"""Of weights in files; the first, of few bytes, are read as float64."""
FITS = atomic.LARGEST * 3 // 4 - 2**16
"""Bytes of weights whose file is read again."""


@dataclass(frozen=True, eq=False)
class NeuralFile(record.Record, format="warp_peri.neural", version=2):
    """Content of a neural material's file; its weights by name, in base 64."""

    horizon: Length
    influence: tuple[int, int]
    state: tuple[int, int]
    anisotropic: bool
    proportional: bool
    strain: Positive
    scale: float
    provenance: Values
    precision: str
    weights: dict[str, str]
    units: Units

    def _read_from(self, path: Path | None) -> NeuralOperator:  # type: ignore[override]
        names = ("influence", "state", *SAID[:5])
        make = partial(NeuralOperator, **{name: getattr(self, name) for name in names})
        with torch.device("meta"):  # where networks take no memory
            shapes = make().state_dict()
        try:
            kind = PRECISIONS[self.precision]
            weights = {
                key: np.frombuffer(base64.b64decode(self.weights[key]), kind).reshape(part.shape)
                for key, part in shapes.items()
            }
        except (KeyError, TypeError, ValueError, OSError, AttributeError) as error:
            raise InputError(f"not a readable neural operator ({error!r:.400})") from None
        for key, part in weights.items():
            checked(key, part)
        material = make() if self.precision == "float32" else make().double()
        material.scale, material.provenance = self.scale, self.provenance
        material.load_state_dict({k: torch.as_tensor(v.astype(float)) for k, v in weights.items()})
        return material
