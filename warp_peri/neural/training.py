"""Training of a neural material."""

from __future__ import annotations

import copy
import io
import math
import time
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import torch
from numpy import ndarray
from numpy.linalg import norm
from scipy.sparse.linalg import SuperLU, splu
from tqdm import tqdm

from warp_peri.errors import InputError, StrPath
from warp_peri.files.atomic import locked
from warp_peri.files.checkpoint import ArrayFile, fingerprint
from warp_peri.fitting.regression import norms
from warp_peri.neural.placed import CELLS, SOLVED, EquilibriumSolver, affine, interpolated_force
from warp_peri.points.arguments import Bound, Count, Positive, Seed, check_whole, typed
from warp_peri.points.dataset import sets_of
from warp_peri.points.points import Samples
from warp_peri.solvers.equilibria import NonlinearRecord

if TYPE_CHECKING:
    from warp_peri.neural.material import NeuralOperator

RENEWED = 10
"""Epochs from one search of all equilibria, and factors of their tangents, to the next."""
FARTHEST = 0.2
"""Of a frame's displacement: an equilibrium that would move by more waits for the next search."""


class Frames:
    """Training samples with known displacement and zero load.

    Every RENEWED epochs each equilibrium is searched from the affine motion of the collar and its
    tangent factorised; in between a visit moves it by one step with these factors (NO14).
    """

    def __init__(self, material: NeuralOperator, samples: Samples) -> None:
        self.material, self.placed = material, material.on(samples.points)
        self.u, self.inside = samples.u, samples.interior
        self.search = EquilibriumSolver(self.placed)
        self.start = np.stack([affine(samples, u) for u in samples.u])
        self.seen = samples.u[:, self.inside]
        self.sizes = norms(self.seen)
        if not (self.sizes > 0).all():
            raise InputError("u: expected every frame displaced inside; (NO8) divides by it")
        self.state = samples.u.copy()
        self.factors: list[SuperLU] = []
        self.numbers: dict[str, torch.Tensor] = {}

    def errors(self, some: torch.Tensor, *_: Any) -> torch.Tensor:
        """Relative ℓ2 errors of the solved displacement."""
        return torch.tensor([self._error(n, self._found(n)[0]) for n in some.tolist()])

    def renew(self) -> None:
        """Search every equilibrium, at last from the frame itself, and factorise its tangent."""
        self.numbers = copy.deepcopy(self.material.state_dict())
        self.factors = []
        for n, seen in enumerate(self.u):
            found, record = self._found(n)
            if not record.converged:
                found, record = self.search.solve_from(0 * self.seen[n], seen, SOLVED)
            self.state[n] = found if record.converged else seen
            self.factors.append(splu(self.placed.interior_tangent(self.state[n])))

    def learn(self, some: torch.Tensor, *_: Any) -> torch.Tensor:
        """Errors of some samples; adds the gradient of their mean to the weights'."""
        chosen = some.tolist()
        force = self.placed(torch.as_tensor(self.state[chosen], dtype=self.placed.dtype))
        weights, errors = np.zeros(force.shape), []
        for weight, n, left in zip(weights, chosen, force.detach().double().numpy()):
            move = -self.factors[n].solve(left.ravel()).reshape(-1, 2)
            moved = self.state[n].copy()
            moved[self.inside] += move
            errors.append(self._error(n, moved))
            if norm(move) > FARTHEST * self.sizes[n] or errors[-1] == 0:
                continue
            self.state[n] = moved
            slope = (moved[self.inside] - self.seen[n]) / (errors[-1] * self.sizes[n] ** 2)
            weight[:] = -self.factors[n].solve(slope.ravel(), trans="T").reshape(-1, 2)
        (force * torch.as_tensor(weights / len(chosen), dtype=force.dtype)).sum().backward()
        return torch.tensor(errors)

    def resume(self, state: torch.Tensor, numbers: dict[str, torch.Tensor]) -> None:
        """Restore equilibria and factors; the factors belong to the weights `numbers`."""
        self.material.load_state_dict(numbers)
        self.renew()
        self.state = state.numpy().copy()

    def _found(self, n: int) -> tuple[ndarray, NonlinearRecord]:
        return self.search.solve_from(0 * self.seen[n], self.start[n], SOLVED)

    def _error(self, n: int, u: ndarray) -> float:
        return float(norm(u[self.inside] - self.seen[n]) / self.sizes[n])


FIRST = 7
"""Samples that the size of an untrained network's force is set by."""
WARM, DECAY = 5, 0.4
"""Epochs in which the rate rises, and the last share of all, in which it falls."""
LOOKED = 5
"""Epochs from one look at the validation samples to the next."""
SAVED = 10.0
"""Seconds between two checkpoints."""


@typed
@dataclass(frozen=True)
class TrainingSettings:
    """Settings of a training.

    Attributes:
        epochs: over the training samples.
        rate: of Adam; it rises over the first epochs and falls to zero over the last two fifths.
        batch: samples a step.
        cells: of the grid that the force state is interpolated on; 0 evaluates it for every bond.
        seed: of the order of the samples and of the grid's places.
    """

    epochs: Count = 150
    rate: Positive = 1e-3
    batch: Count = 7
    cells: Annotated[int, Bound("0 to 4096 cells", range(4097).__contains__)] = CELLS
    seed: Seed = 0


@dataclass
class TrainingHistory:
    """Epochs and seconds of a training, the `best` epoch, whose weights are kept, and error curve.
    The curve has epoch, mean training error in it, and validation error, of every look."""

    epochs: int = 0
    seconds: float = 0.0
    curve: list[tuple[int, float, float]] = field(default_factory=list)
    best: int = 0


class _Loads:
    """Training samples with known loads (NO7)."""

    def __init__(self, material: NeuralOperator, samples: Samples) -> None:
        self.placed = material.on(samples.points)
        dtype = self.placed.dtype
        self.u = torch.as_tensor(samples.u, dtype=dtype)
        self.b = torch.as_tensor(samples.loads[:, samples.interior], dtype=dtype)
        if not (self.b.flatten(1).norm(dim=1) > 0).all():
            raise InputError("b: expected a load in every sample; (NO7) divides by it")

    def errors(
        self, some: torch.Tensor, cells: int, offset: tuple[float, float] = (0.5, 0.5)
    ) -> torch.Tensor:
        """Relative ℓ2 errors of the load b of some samples."""
        u = self.u[some]
        if cells:
            force = interpolated_force(self.placed, u, cells=cells, offset=offset)
        else:
            force = self.placed(u)
        left, b = (f.flatten(1).norm(dim=1) for f in (force - self.b[some], self.b[some]))
        return torch.as_tensor(left / b)

    def learn(self, some: torch.Tensor, cells: int, offset: tuple[float, float]) -> torch.Tensor:
        """Errors of some samples; adds the gradient of their mean to the weights'."""
        errors = self.errors(some, cells, offset)
        errors.mean().backward()
        return errors.detach()


@dataclass(frozen=True)
class NeuralFit:
    """Trained neural operator with the weights of its best epoch; nothing is proven of it."""

    material: NeuralOperator
    history: TrainingHistory


@typed
@torch.inference_mode(False)
def train(
    material: NeuralOperator,
    samples: Samples,
    val: Samples,
    training: TrainingSettings,
    *,
    checkpoint: StrPath | None = None,
    progress: bool = True,
) -> TrainingHistory:
    """Train the material's weights in place; keeps those of least train + val error.

    Every interior node counts. With more epochs than a `checkpoint` has, a file written every ten
    seconds, the work goes on from there; `progress` is a bar on stderr. Raises InputError for no
    samples, one of zero load or a frame at rest, loads in one set alone, networks of other modules
    (see NeuralOperator), a checkpoint of other settings or samples or of a job that still runs,
    and a training that diverges.
    """
    if not (len(samples) and len(val)):
        raise InputError("samples: expected at least one, got none")
    if (samples.b is None) != (val.b is None):
        asked = "no loads" if samples.b is None else "loads"
        raise InputError(f"validation: expected {asked}, as the training samples have")
    sets_of([samples, val])
    run = _Run(material, samples, val, training)
    file = ArrayFile(checkpoint, run.key, "another training: other settings, samples or start")
    with nullcontext() if checkpoint is None else locked(checkpoint):
        run.resume(file)
        history, now = run.history, time.perf_counter()
        began, saved = now - history.seconds, now
        epochs = training.epochs
        bar = tqdm(total=epochs, initial=history.epochs, unit="epoch", disable=not progress)
        while history.epochs < epochs:
            error = run.epoch()
            history.seconds = time.perf_counter() - began
            bar.update()
            last = history.epochs == epochs
            if last or history.epochs % LOOKED == 0:
                bar.set_postfix(train=f"{100 * error:.2f} %", val=f"{100 * run.look(error):.2f} %")
            if last or time.perf_counter() - saved > SAVED:
                run.save(file)
                saved = time.perf_counter()
        bar.close()
    if not run.kept:
        raise InputError(
            f"training: no look found a finite error; a rate below {training.rate:g} may have one"
        )
    material.load_state_dict(run.kept)
    return history


class _Run:
    """State of a training; a checkpoint's key is all but the number of epochs."""

    def __init__(
        self, material: NeuralOperator, samples: Samples, val: Samples, training: TrainingSettings
    ) -> None:
        self.material, self.training = material, training
        kind = Frames if samples.b is None else _Loads
        self.learned, self.unseen = (kind(material, one) for one in (samples, val))
        self.adam = torch.optim.Adam(material.parameters(), lr=training.rate)
        self.random = torch.Generator().manual_seed(training.seed)
        self.history, self.least = TrainingHistory(), math.inf
        read = [replace(one, arrays={}) for one in (samples, val)]
        free = [one.requires_grad for one in material.parameters()]
        if not any(free):
            raise InputError("material: expected weights to learn, all are frozen")
        self.key = fingerprint(replace(training, epochs=1), material, free, read)
        self.kept: dict[str, torch.Tensor] = {}

    def start(self) -> None:
        """Scale the force to be as large as the loads."""
        learned, before = self.learned, self.material.scale
        if isinstance(learned, _Loads):
            self.material.scale = 1.0
            with torch.no_grad():
                size = float(interpolated_force(learned.placed, learned.u[:FIRST]).double().norm())
            self.material.scale = float(learned.b[:FIRST].norm()) / size if size > 0 else before

    def epoch(self) -> float:
        """Train one epoch over all samples; returns the mean error on the way."""
        training, count = self.training, len(self.learned.u)
        now, epochs = self.history.epochs, training.epochs
        if isinstance(self.learned, Frames) and now % RENEWED == 0:
            self.learned.renew()
        # the rate rises, stays, and falls to zero by half a cosine
        fall = 0.5 - 0.5 * math.cos(math.pi * min(1.0, (epochs - now) / (DECAY * epochs)))
        for group in self.adam.param_groups:
            group["lr"] = training.rate * (min(1.0, (now + 1) / WARM) * fall)
        total = 0.0
        for some in torch.randperm(count, generator=self.random).split(training.batch):
            x, y = torch.rand(2, generator=self.random).tolist()
            self.adam.zero_grad()
            errors = self.learned.learn(some, training.cells, (x, y))
            self.adam.step()
            total += float(errors.sum()) / count
        self.history.epochs += 1
        return total

    @torch.no_grad()
    def look(self, error: float) -> float:
        """Compute the validation error; keeps the weights if they are the best."""
        every = torch.arange(len(self.unseen.u))
        other = float(self.unseen.errors(every, self.training.cells).mean())
        self.history.curve.append((self.history.epochs, error, other))
        if error + other < self.least:
            self.least, self.history.best = error + other, self.history.epochs
            self.kept = copy.deepcopy(self.material.state_dict())
        return other

    def save(self, file: ArrayFile) -> None:
        """Write a checkpoint."""
        state = {
            "scale": self.material.scale,
            "adam": self.adam.state_dict(),
            "material": self.material.state_dict(),
            "random": self.random.get_state(),
            "history": asdict(self.history),
            "least": self.least,
            "kept": self.kept,
        }
        if isinstance(self.learned, Frames):
            state["frames"] = torch.as_tensor(self.learned.state), self.learned.numbers
        torch.save(state, stream := io.BytesIO())
        file.write({"state": np.frombuffer(stream.getvalue(), np.uint8)})

    def resume(self, file: ArrayFile) -> None:
        """Continue from a checkpoint, if there is one, else start."""
        if (held := file.read({"state": np.zeros(0, np.uint8)})) is None:
            return self.start()
        material = self.material
        before = copy.deepcopy(material.state_dict())
        try:
            state = torch.load(io.BytesIO(held["state"].tobytes()), weights_only=True)
            self.history = TrainingHistory(**state["history"])
            done = check_whole(f"{file.path}: epochs", self.history.epochs, 1)
            if done > self.training.epochs:
                raise InputError(
                    f"{file.path}: expected at least its {done} epochs, got "
                    f"{self.training.epochs}; name another file for a shorter training"
                )
            if isinstance(self.learned, Frames):
                self.learned.resume(*state["frames"])
            material.load_state_dict(state["material"])
            self.adam.load_state_dict(state["adam"])
            self.random.set_state(state["random"])
            material.scale, self.least = float(state["scale"]), float(state["least"])
            self.kept = state["kept"]
        except InputError:
            raise
        except Exception as error:  # whatever torch raises for what it did not write
            material.load_state_dict(before)
            raise InputError(f"{file.path}: not a readable checkpoint ({error!r:.200})") from None
