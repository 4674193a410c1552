"""`python -m lightning_modules fit --config FILE`: Lightning's command line."""

from __future__ import annotations

from lightning.pytorch.cli import LightningCLI

from lightning_modules.datamodule import ExpLogDataModule
from lightning_modules.pretrain import ExpLogPretraining


def main(args: list[str] | None = None) -> None:
    """Runs `fit` or `validate`; every option of trainer, model and data is a flag or a YAML key."""
    LightningCLI(
        ExpLogPretraining,
        ExpLogDataModule,
        args=args,
        save_config_kwargs={"overwrite": True},
        seed_everything_default=0,
    )
