"""The peridynamic neural operator: influence function and force state as networks (NO1–NO13)."""

from warp_peri.neural.material import NeuralOperator
from warp_peri.neural.placed import EquilibriumSolver, evaluate
from warp_peri.neural.training import NeuralFit, TrainingSettings, train

__all__ = ["EquilibriumSolver", "NeuralFit", "NeuralOperator", "TrainingSettings"]
__all__ += ["evaluate", "train"]
