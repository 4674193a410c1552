"""`riemlayer pretrain` and `tables`."""

from __future__ import annotations

import contextlib
import io
import json
import signal
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from riemlayer.cli.command import Answer, command
from riemlayer.cli.errors import UserError
from riemlayer.cli.loaded import check_weights
from riemlayer.cli.options import Weights
from riemlayer.cli.output import whole_file
from riemlayer.cli.prepare import PANEL, Folder, check_folder


def register(app: typer.Typer) -> None:
    """Adds the subcommands of this file."""
    command(
        app,
        "riemlayer pretrain DIR -o runs/mine --steps 20000",
        PANEL,
        bar=False,
        context_settings={"ignore_unknown_options": True},
    )(pretrain)
    command(app, "riemlayer tables --fast -o tables", PANEL, bar=False)(tables)


def pretrain(
    samples: Annotated[
        list[str],
        typer.Argument(
            metavar="DIR...",
            help="Folders by `riemlayer prepare`, or folders or URLs of its shards; then any flags "
            "of Lightning's command line.",
        ),
    ],
    out: Folder,
    steps: Annotated[
        int | None, typer.Option(help="Training steps; those of the configuration.", min=1)
    ] = None,
    preset: Annotated[str, typer.Option(help="base, paper or tiny.")] = "base",
    start_from: Annotated[
        str | None, typer.Option(help="Packaged name or folder of weights to go on from.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="YAML in the place of lightning_modules/configs/base.yaml.")
    ] = None,
) -> Answer | None:
    """Trains a field on prepared shapes; a run that stopped is continued by the same call.

    DIR/average holds the averaged weights, to be named by --weights or from_pretrained;
    DIR/last.ckpt is what `riemlayer export` packs. Unknown flags go to Lightning, such as
    --trainer.devices 2.
    """
    cut = next((i for i, x in enumerate(samples) if x.startswith("-")), len(samples))
    folders, flags = samples[:cut], samples[cut:]
    check_folder(out, *map(Path, folders))
    cli = import_module("lightning_modules.cli")
    settings = read_settings(config)
    adapt(settings, folders, out, steps, preset, start_from)
    import yaml

    out.mkdir(parents=True, exist_ok=True)
    with whole_file(out / "pretrain.yaml") as path:
        path.write_text(yaml.safe_dump(settings, sort_keys=False), "utf-8")
    resumed = (out / "last.ckpt").is_file()
    go_on = ["--ckpt_path", str(out / "last.ckpt")] if resumed else []
    with library_run():
        cli.main(["fit", "--config", str(out / "pretrain.yaml"), *flags, *go_on])
    if import_module("lightning.pytorch.utilities").rank_zero_only.rank:
        return None  # the first rank answers
    weights, checkpoint = out / "average", out / "last.ckpt"
    if missing := [path.name for path in (weights, checkpoint) if not path.exists()]:
        raise UserError(
            f"{out}: the run ended and kept no {' and no '.join(missing)}; a --config needs the "
            "callbacks ExponentialAverage and SoundCheckpoint of the packaged one, and nothing is "
            "kept while the loss is far above its median"
        )
    facts = {"out": str(out), "weights": str(weights), "checkpoint": str(checkpoint)}
    return Answer(facts | {"resumed": resumed}, f"{weights}: weights; {checkpoint}: checkpoint")


def read_settings(config: Path | None) -> dict[str, Any]:
    """A training configuration from a YAML file, the packaged one by default."""
    import yaml

    if config is None:
        package = import_module("lightning_modules").__file__ or ""
        config = Path(package).parent / "configs" / "base.yaml"
    try:
        settings = yaml.safe_load(config.read_text("utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UserError(f"--config {config}: must be YAML: {error}") from error
    if not isinstance(settings, dict) or not {"model", "data", "trainer"} <= {*settings}:
        raise UserError(f"--config {config}: must have the keys model, data and trainer")
    return settings


def adapt(
    settings: dict[str, Any],
    folders: list[str],
    out: Path,
    steps: int | None,
    preset: str,
    start_from: str | None,
) -> None:
    """Puts what the user said into a configuration."""
    from riemlayer.config import FieldConfig

    try:
        FieldConfig.preset(preset)
    except ValueError as error:
        raise UserError(f"--preset: {error}") from error
    trainer = settings["trainer"]
    settings["model"] |= {"preset": preset}
    if start_from is not None:
        check_weights(start_from, "--start-from")
        settings["model"]["start_from"] = start_from
    settings["data"] |= {"roots": folders, "validation": held_out(folders)}
    if steps is not None:
        trainer["max_steps"] = steps
    most = trainer.get("max_steps", -1)
    if most > 0:
        trainer["val_check_interval"] = min(trainer.get("val_check_interval", 500), most)
    trainer |= {"precision": precision(), "accelerator": accelerator()}
    trainer.setdefault("enable_progress_bar", sys.stderr.isatty())
    trainer["default_root_dir"] = str(out)
    if isinstance(trainer.get("logger"), dict):
        trainer["logger"].setdefault("init_args", {})["save_dir"] = str(out)
    for callback in trainer.get("callbacks") or ():
        own = callback.setdefault("init_args", {})
        if "dirpath" in own:
            own |= {"dirpath": str(out)}
            own["every_n_train_steps"] = min(own.get("every_n_train_steps", 250), max(most, 1))
        if "export" in own:
            own |= {"export": str(out / "average")}


def accelerator() -> str:
    """Lightning's name of what to train on."""
    import torch

    return "gpu" if torch.cuda.is_available() else "cpu"


def precision() -> str:
    """bfloat16 where the machine has it: elsewhere it would only be emulated."""
    import torch

    native = torch.cuda.is_available() or torch.cpu._is_avx512_bf16_supported()
    return "bf16-mixed" if native else "32-true"


def held_out(roots: list[str]) -> float:
    """The fraction of shapes to validate on: 3 %, or as much more as one shape takes."""
    from riemlayer.data.dataset import sample_files, split
    from riemlayer.data.stream import ShardedSamples, is_sharded

    try:
        if any(is_sharded(root) for root in roots):
            samples = ShardedSamples(roots)
            names = [Path(str(name)) for name in samples.table["name"]]
        else:
            names = sample_files(roots)
    except FileNotFoundError as error:
        raise UserError(f"{error}; make some with riemlayer prepare") from error
    for percent in range(3, 100):
        train, held = split(names, percent / 100)
        if train and held:
            return percent / 100
    raise UserError(f"{' '.join(roots)}: holds {len(names)} shapes, too few to hold one out")


@contextlib.contextmanager
def library_run() -> Iterator[None]:
    """What libraries print is no answer of ours, and being stopped is no success."""
    diverged = import_module("lightning_modules").DivergedError
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    except diverged as error:
        raise UserError(str(error)) from error
    except SystemExit as end:
        if isinstance(end.__context__, KeyboardInterrupt):
            raise SystemExit(128 + signal.SIGINT) from end
        if end.code is None:  # Lightning, after SIGTERM
            raise SystemExit(128 + signal.SIGTERM) from end
        raise
    except RuntimeError as error:
        if "DataLoader worker" in str(error):
            raise UserError(
                "a process that loads data was killed, perhaps for want of memory; the same call "
                f"goes on from the last checkpoint ({error})"
            ) from error
        raise


def tables(
    directory: Annotated[
        Path | None,
        typer.Argument(
            help="Prepared shapes GROUP/NAME.npz, or meshes; procedural ones if none.",
            show_default=False,
        ),
    ] = None,
    out: Folder = Path("tables"),
    fast: Annotated[bool, typer.Option("--fast", help="One shape a group, two sources.")] = False,
    weights: Weights = "base",
    groups: Annotated[str | None, typer.Option(help="Comma-separated; all.")] = None,
    methods: Annotated[str | None, typer.Option(help="Comma-separated; all.")] = None,
    limit: Annotated[int | None, typer.Option(help="Shapes a group; all.", min=1)] = None,
    sources: Annotated[int | None, typer.Option(help="Sources a shape; all.", min=1)] = None,
    figures: Annotated[bool, typer.Option(help="Draw figures too.")] = True,
) -> Answer:
    """The paper's tables, with every rival, on shapes that training never saw.

    Writes tables.md, tables.json and figures; a run that was cut off goes on where it stopped.
    """
    program = import_module("riemlayer.tables.__main__")
    check_folder(out, *([] if directory is None else [directory]))
    arguments = [] if directory is None else [str(directory)]
    given = {"groups": groups, "methods": methods, "limit": limit, "sources": sources}
    for name, value in {"out": out, "weights": weights, **given}.items():
        arguments += [] if value is None else [f"--{name}", str(value)]
    arguments += ["--fast"] * fast + ["--no-figures"] * (not figures)
    try:
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            program.main(arguments)
    except SystemExit as error:
        if isinstance(error.code, str):
            raise UserError(error.code.removeprefix("riemlayer.tables: ")) from error
        raise
    found = json.loads((out / "tables.json").read_text("utf-8"))["methods"]
    rows = {name: method["groups"] for name, method in found.items()}
    failed = {name: method["failed"] for name, method in found.items() if method["failed"]}
    facts = {"out": str(out), "methods": rows, "failed": failed}
    return Answer(facts, printed.getvalue().rstrip())
