"""Training of the printed network: a budget of processor time, settings that compete for it."""

from __future__ import annotations

import hashlib
import itertools
import math
import os
import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import torch
from tqdm import tqdm

from warp_peri.files.atomic import whole_file

EVERY = 60.0
"""Seconds of processor time between two checkpoints."""
FINALISTS = 3
"""Settings that meet again after the first round, with as many times the budget."""


class Setting(NamedTuple):
    """Widths of the hidden layers, rate of Adam, samples a step."""

    widths: tuple[int, int]
    rate: float
    batch: int = 4


SETTINGS = (
    *(Setting(w, r) for w, r in itertools.product(((16, 32), (32, 64), (64, 128)), (2e-3, 6e-3))),
    Setting((256, 512), 1e-3),
)
"""What is tried; the last has the paper's widths."""

Fields = tuple[torch.Tensor, torch.Tensor]


def relative(force: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Relative ℓ2 errors, shape [S]."""
    return (force - b).flatten(1).norm(dim=1) / b.flatten(1).norm(dim=1)


def train(
    make: Callable[[int, int], Any],
    learned: Fields,
    validation: Fields,
    setting: Setting,
    minutes: float,
    *,
    folder: Path,
    quiet: bool = False,
) -> tuple[Any, dict[str, Any]]:
    """Adam with a cosine over the budget; the weights of least validation error count.

    A run that was stopped goes on from its last checkpoint; one that ended is read.
    """
    u, b = learned
    torch.manual_seed(0)
    model = make(*setting.widths)
    with torch.no_grad():
        model.scale = float(b[:20].norm() / model(u[:20]).norm())
    adam = torch.optim.Adam(model.parameters(), lr=setting.rate)
    path = folder / f"{_key(setting, minutes, learned)}.pt"
    state = _read(path)
    spent, epochs, best = 0.0, 0, math.inf
    kept = {key: value.clone() for key, value in model.state_dict().items()}
    if state is not None:
        model.load_state_dict(state["model"])
        adam.load_state_dict(state["adam"])
        torch.set_rng_state(state["random"])
        spent, epochs, best, kept = (state[key] for key in ("spent", "epochs", "best", "kept"))
    bar = tqdm(total=round(60 * minutes), unit="s", disable=quiet, leave=False)
    clock, saved = time.process_time(), spent
    while spent < 60 * minutes:
        part = min(1.0, spent / (60 * minutes))
        for group in adam.param_groups:
            group["lr"] = setting.rate * (0.5 + 0.5 * math.cos(math.pi * part)) + 1e-6
        for batch in torch.randperm(len(u)).split(setting.batch):
            adam.zero_grad()
            relative(model(u[batch]), b[batch]).mean().backward()
            adam.step()
        epochs += 1
        error = validation_error(model, validation)
        if error < best:
            best = error
            kept = {key: value.clone() for key, value in model.state_dict().items()}
        spent, clock = spent + time.process_time() - clock, time.process_time()
        bar.n = round(spent)
        bar.set_postfix(validation=f"{100 * error:.2f} %")
        if spent - saved > EVERY or spent >= 60 * minutes:
            saved = spent
            state = {"model": model.state_dict(), "adam": adam.state_dict(), "kept": kept}
            state |= {"random": torch.get_rng_state(), "spent": spent, "epochs": epochs}
            with whole_file(path) as temporary:
                torch.save(state | {"best": best}, temporary)
    model.load_state_dict(kept)
    numbers = sum(p.numel() for p in model.parameters() if p.requires_grad)
    return model, {"epochs": epochs, "numbers": numbers, "seconds": spent, "best": best}


def chosen_setting(
    make: Callable[[int, int], Any],
    learned: Fields,
    validation: Fields,
    minutes: float,
    *,
    folder: Path,
    quiet: bool = False,
) -> dict[str, Any]:
    """The setting of least validation error after two rounds, and all errors.

    Every setting has so many minutes; the best ones start again with more.
    """
    errors: dict[str, float] = {}
    running: tuple[Setting, ...] = SETTINGS
    for times in (1, FINALISTS):
        left = {}
        for setting in running:
            budget = times * minutes
            _, record = train(
                make, learned, validation, setting, budget, folder=folder, quiet=quiet
            )
            left[setting] = record["best"]
            label = f"widths {setting.widths}, rate {setting.rate:g}, {budget:g} min"
            errors[label] = record["best"]
        running = tuple(sorted(left, key=left.__getitem__)[:FINALISTS])
    return {"setting": running[0], "tried": errors}


def validation_error(model: Any, validation: Fields) -> float:
    """Mean relative residual, infinite where the network has diverged."""
    u, b = validation
    with torch.no_grad():
        errors = torch.cat([relative(model(u[n : n + 1]), b[n : n + 1]) for n in range(len(u))])
    error = float(errors.mean())
    return error if math.isfinite(error) else math.inf


def _key(setting: Setting, minutes: float, learned: Fields) -> str:
    """What a run depends on, as the name of its file."""
    content = [repr((setting, minutes)).encode()]
    content += [field.contiguous().numpy().tobytes() for field in learned]
    return hashlib.sha256(b"".join(content)).hexdigest()[:20]


def _read(path: str | os.PathLike[str]) -> dict[str, Any] | None:
    """A checkpoint; none where there is no file, or one that cannot be read."""
    try:
        state: dict[str, Any] = torch.load(path, weights_only=True)
    except (OSError, RuntimeError, pickle.UnpicklingError, EOFError):
        return None
    return state
