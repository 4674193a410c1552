"""Training and prediction with Lightning."""

from lightning_modules.callbacks import ExponentialAverage
from lightning_modules.checkpoints import AtomicCheckpointIO, SoundCheckpoint
from lightning_modules.clouds import CloudDataModule
from lightning_modules.datamodule import ExpLogDataModule
from lightning_modules.finetune import ExpLogFineTuning
from lightning_modules.guard import DivergedError, DivergenceGuard
from lightning_modules.heads import ExpLogHeadFitting, LookUpModule
from lightning_modules.monitors import Memory, Throughput
from lightning_modules.predict import CloudFilesModule, ExpLogPredictor
from lightning_modules.pretrain import ExpLogPretraining
from lightning_modules.writer import PredictionFiles

__all__ = [
    "AtomicCheckpointIO",
    "CloudDataModule",
    "CloudFilesModule",
    "DivergedError",
    "DivergenceGuard",
    "ExpLogDataModule",
    "ExpLogFineTuning",
    "ExpLogHeadFitting",
    "ExpLogPredictor",
    "ExpLogPretraining",
    "ExponentialAverage",
    "LookUpModule",
    "Memory",
    "PredictionFiles",
    "SoundCheckpoint",
    "Throughput",
]
