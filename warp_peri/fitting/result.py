"""What a fit returns: the model, the stages on the way to it, and what was asked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from warp_peri.fitting.settings import Conditions
from warp_peri.points.unit_names import shown_moduli, symbols
from warp_peri.shown import Shown

if TYPE_CHECKING:
    from warp_peri.materials.certificate import Certificate
    from warp_peri.materials.influence import InfluenceFunction
    from warp_peri.materials.lps import Model, Solid


@dataclass(frozen=True)
class LossSelection:
    """A loss and, in words, why it was taken."""

    name: str
    reason: str


@dataclass(frozen=True)
class Stage:
    """One stage of a fit: its result, E_res on the training set, and how long it took.

    `loss` is the trace of the loss: by epoch, or round of cuts; `steps` counts gradients of Warp's
    operator in stages of Adam, starts in stage 3.
    """

    name: str
    parameters: Solid
    E_res_train: float
    seconds: float
    loss: list[float] = field(repr=False)
    steps: int = 0


@dataclass(frozen=True)
class FitSettings:
    """What a fit was asked for: conditions on each lattice with their ζ, and moduli held."""

    conditions: Conditions
    moduli: tuple[float, float] | str | None


@dataclass(frozen=True, repr=False)
class Fit(Shown):
    """A learned model and how it was learned.

    Attributes:
        material: the model; certified for the training spacing if its certificate holds.
        certificates: the certificate on each training lattice.
        moduli: long-wave moduli C11, C12, C44 of the discrete operator on each of them [TPa].
        history: the stages, in order.
        starts: E of stage 3 by start, the square root of its relative loss; empty when not run.
        loss: which loss was minimised, and why.
        settings: what was asked for.
        influence: the influence function with its learned parameters, where one was given.
    """

    material: Model
    certificates: list[Certificate]
    moduli: list[dict[str, float]]
    history: list[Stage]
    starts: dict[str, float]
    loss: LossSelection
    settings: FitSettings
    influence: InfluenceFunction | None = None

    @property
    def certificate(self) -> Certificate:
        """The certificate on the first training lattice."""
        return self.certificates[0]

    def rows(self) -> list[tuple[str, str]]:
        """What to know of a fit at a glance: name and value."""
        model, last = self.material, self.history[-1] if self.history else None
        length = symbols(model.units)[0]
        lattices = ", ".join(f"{h:g} {length}" for h in model.certified_on) or "no lattice"
        lines = [
            ("λ, μ", shown_moduli(model.units, (model.lam, model.mu))),
            ("E, ν", f"{shown_moduli(model.units, (model.E,))}, {model.nu:.3g}"),
            (
                "kernel",
                f"M = {model.degree}, δ = {model.horizon:g} {length}, α = {model.alpha:.3g}",
            ),
        ]
        for constants in self.moduli[:1]:
            numbers = (constants[key] for key in ("C11", "C12", "C44"))
            held = "" if self.settings.moduli is None else ", held"
            lines.append(("C11, C12, C44", shown_moduli(model.units, numbers) + held))
        if last is not None:
            lines.append(("residual", f"{100 * last.E_res_train:.3g} % of the training loads"))
        lines.append(("loss", f"{self.loss.name} ({self.loss.reason})"))
        lines.append(("certified on", lattices))
        lines += [("", certificate.statement) for certificate in self.certificates[:1]]
        return lines

    def _repr_html_(self) -> str:
        """For notebooks: the same as a table, and K over r."""
        return super()._repr_html_() + _influence_svg(self.material)


def _influence_svg(model: Model) -> str:
    """K(r)/max|K| as a small drawing."""
    unit = symbols(model.units)[0]
    r = np.linspace(model.horizon / 8, model.horizon, 200)
    K = model.influence(r)
    x, y = 300 * r / model.horizon, 60 - 50 * K / np.abs(K).max()
    path = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y))
    return (
        "<svg width='320' height='140' role='img' aria-label='influence function'>"
        "<line x1='0' y1='60' x2='300' y2='60' stroke='gray'/>"
        f"<polyline points='{path}' fill='none' stroke='steelblue' stroke-width='2'/>"
        "<text x='0' y='135' font-size='11'>K(r), r from 0 to "
        f"δ = {model.horizon:g} {unit}</text></svg>"
    )
