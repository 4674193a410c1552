"""Training with Lightning."""

from lightning_modules.callbacks import ExponentialAverage
from lightning_modules.datamodule import ExpLogDataModule
from lightning_modules.pretrain import ExpLogPretraining

__all__ = ["ExpLogDataModule", "ExpLogPretraining", "ExponentialAverage"]
