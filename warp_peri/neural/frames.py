"""Learning from displacement alone (NO8): equilibria are followed while the material learns."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from scipy.sparse.linalg import SuperLU

from warp_peri.errors import InputError
from warp_peri.neural.equilibrium import Found, NeuralEquilibrium
from warp_peri.neural.material import NeuralOperator
from warp_peri.points.samples import Samples

SOLVED = 1e-5
"""Tolerance of the equilibria."""
RENEWED = 10
"""Epochs from one search of all equilibria, and factors of their tangents, to the next."""
FARTHEST = 0.2
"""Of a frame's displacement: an equilibrium that would move by more waits for the next search."""


class Frames:
    """Samples whose displacement is seen and whose load is zero.

    Every RENEWED epochs each equilibrium is searched from the affine motion of the collar, as it
    will be where nothing but the collar is known, and the tangent there is factorised. In between
    a visit moves it by one step with these factors and learns from where it is then, (NO14).
    """

    def __init__(self, material: NeuralOperator, samples: Samples) -> None:
        self.samples, self.material = samples, material
        self.placed = material.on(samples.points)
        self.u = torch.as_tensor(samples.u, dtype=self.placed.dtype)
        self.rows, self.search = self.placed.bonds.rows, NeuralEquilibrium(self.placed)
        self.start = np.stack([affine(samples, u) for u in samples.u])
        self.seen = samples.u[:, self.rows]
        self.sizes = np.linalg.norm(self.seen.reshape(len(self.seen), -1), axis=1)
        if not (self.sizes > 0).all():
            raise InputError("u: expected every frame displaced inside; (NO8) divides by it")
        self.state = samples.u.copy()
        self.factors: list[SuperLU] = []
        self.numbers: dict[str, torch.Tensor] = {}

    def errors(self, some: torch.Tensor, *_: Any) -> torch.Tensor:
        """Relative ℓ2 errors of the displacement that is solved for."""
        return torch.tensor([self._error(int(n), self._found(int(n)).u) for n in some])

    def renew(self) -> None:
        """Search every equilibrium, at last from the frame itself, and factorise its tangent."""
        self.numbers = {key: part.clone() for key, part in self.material.state_dict().items()}
        self.factors = []
        for n, seen in enumerate(self.u.double().numpy()):
            found = self._found(n)
            if not found.converged:
                found = self.search.solve(np.zeros_like(seen), seen, tolerance=SOLVED)
            self.state[n] = found.u if found.converged else seen
            field = torch.as_tensor(self.state[n], dtype=self.u.dtype)
            self.factors.append(self.search.factors_of(self.placed.tangent(field)))

    def learn(self, some: torch.Tensor, *_: Any) -> torch.Tensor:
        """The errors, with gradients of their mean added to the material's."""
        chosen = some.tolist()
        force = self.placed(torch.as_tensor(self.state[chosen], dtype=self.u.dtype))
        weights, errors = np.zeros(force.shape), []
        for weight, n, left in zip(weights, chosen, force.detach().double().numpy()):
            move = -self.factors[n].solve(left.ravel()).reshape(-1, 2)
            moved = self.state[n].copy()
            moved[self.rows] += move
            errors.append(self._error(n, moved))
            if np.linalg.norm(move) > FARTHEST * self.sizes[n] or errors[-1] == 0:
                continue
            self.state[n] = moved
            slope = (moved[self.rows] - self.seen[n]) / (errors[-1] * self.sizes[n] ** 2)
            weight[:] = -self.factors[n].solve(slope.ravel(), trans="T").reshape(-1, 2)
        (force * torch.as_tensor(weights / len(chosen), dtype=force.dtype)).sum().backward()
        return torch.tensor(errors)

    def content(self) -> dict[str, Any]:
        """What a training goes on from."""
        return {"state": torch.as_tensor(self.state), "numbers": self.numbers}

    def resume(self, content: dict[str, Any]) -> None:
        """Equilibria and factors as they were; the material's numbers are those of the factors."""
        self.material.load_state_dict(content["numbers"])
        self.renew()
        self.state = content["state"].numpy().copy()

    def _found(self, n: int) -> Found:
        start = self.start[n]
        return self.search.solve(np.zeros_like(start), start, tolerance=SOLVED)

    def _error(self, n: int, u: np.ndarray) -> float:
        return float(np.linalg.norm(u[self.rows] - self.seen[n]) / self.sizes[n])


def affine(samples: Samples, u: np.ndarray) -> np.ndarray:
    """A field with the interior on the affine motion that fits its collar best, shape [N, 2]."""
    places = np.column_stack([samples.x, np.ones(len(u))])
    collar = ~samples.interior
    motion, *_ = np.linalg.lstsq(places[collar], u[collar], rcond=None)
    return np.where(collar[:, None], u, places @ motion)
