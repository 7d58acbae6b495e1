"""The peridynamic neural operator: influence function and force state as networks (NO1–NO13)."""

from warp_peri.neural.material import NeuralOperator
from warp_peri.neural.placed import NeuralEquilibrium, evaluate
from warp_peri.neural.training import NeuralFit, Training, train

__all__ = ["NeuralEquilibrium", "NeuralFit", "NeuralOperator", "Training", "evaluate", "train"]
