"""Training with Lightning."""

from lightning_modules.callbacks import ExponentialAverage
from lightning_modules.clouds import CloudDataModule
from lightning_modules.datamodule import ExpLogDataModule
from lightning_modules.finetune import ExpLogFineTuning
from lightning_modules.pretrain import ExpLogPretraining

__all__ = [
    "CloudDataModule",
    "ExpLogDataModule",
    "ExpLogFineTuning",
    "ExpLogPretraining",
    "ExponentialAverage",
]
