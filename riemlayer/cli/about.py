"""`riemlayer info` and `bench`."""

from __future__ import annotations

import json
import platform
import re
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import numpy as np
import typer

from riemlayer.cli.command import Answer, command
from riemlayer.cli.errors import UserError
from riemlayer.cli.loaded import Encoding, load_field, read
from riemlayer.cli.options import Device, Weights
from riemlayer.cli.progress import stage

PANEL = "About this installation"
TOLD = ("licence", "limits", "time")
"""Facts of a model card that are told as they are."""


def register(app: typer.Typer) -> None:
    """Adds the subcommands of this file."""
    command(app, "riemlayer info bunny.ply", PANEL)(info)
    command(app, "riemlayer bench --threads 2 --json", PANEL)(bench)


def info(
    shape: Annotated[
        Path | None, typer.Argument(help="Also what this file holds.", show_default=False)
    ] = None,
    weights: Weights = "base",
) -> Answer:
    """The weights' model card, versions, devices and extras; with SHAPE, what that file holds."""
    import torch

    from riemlayer import __version__

    card = card_facts(weights)
    found = {} if shape is None else {"shape": shape_facts(shape, card["radius"])}
    facts: dict[str, Any] = found | {"card": card}
    facts["versions"] = {
        "riemlayer": __version__,
        "python": platform.python_version(),
        "torch": torch.__version__,
        "numpy": np.__version__,
    }
    cuda = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())]
    facts["devices"] = {
        "cuda": cuda,
        "threads": torch.get_num_threads(),
        "bfloat16": bool(torch.cpu._is_avx512_bf16_supported()),
    }
    facts["extras"] = extras()
    return Answer(facts, as_text(facts))


def shape_facts(path: Path, radius: float) -> dict[str, Any]:
    """What a file holds, in its own units; `radius` is the field's, in the cube."""
    raw = read(path)
    x = raw.positions if raw.vertices is None else raw.vertices
    low, high = x.min(0), x.max(0)
    size = float((high - low).max())
    return {
        "file": str(path),
        "kind": "cloud" if raw.faces is None else "mesh",
        "points": len(x),
        "faces": 0 if raw.faces is None else len(raw.faces),
        "normals": raw.normals is not None,
        "colours": raw.colours is not None,
        "unit": raw.unit,
        "low": low.tolist(),
        "high": high.tolist(),
        "longest_side": size,
        "trained_radius": radius * size / 2,
    }


def card_facts(weights: str) -> dict[str, Any]:
    """What the model card beside the weights says."""
    packaged = Path(__file__).parents[1] / "weights" / f"{weights}.json"
    path = packaged if packaged.is_file() else Path(weights) / "config.json"
    try:
        card = json.loads(path.read_text("utf-8"))
    except FileNotFoundError as error:
        raise UserError(f"--weights {weights}: must be `base` or a folder with a card") from error
    except (ValueError, OSError) as error:
        raise UserError(f"{path}: must be a model card in JSON: {error}") from error
    if not isinstance(card, dict) or "radius" not in card.get("config", {}):
        raise UserError(f"{path}: must be a model card with `config` and its `radius`")
    training = card.get("training", {})
    facts = {"weights": weights, "radius": card["config"]["radius"]}
    facts |= {k: training[k] for k in ("parameters", "steps", "hours") if k in training}
    facts |= {"shapes": training["shapes"]} if "shapes" in training else {}
    facts |= {k: card[k] for k in TOLD if k in card}
    return facts | (card["data"] if isinstance(card.get("data"), dict) else {})


def extras() -> dict[str, list[str]]:
    """Packages that each extra of riemlayer still lacks here."""
    missing: dict[str, list[str]] = {}
    for line in metadata.requires("riemlayer") or ():
        name = re.match(r"[\w.-]+", line)
        extra = re.search(r"extra == ['\"]([\w-]+)['\"]", line)
        if name and extra:
            lacks = missing.setdefault(extra[1], [])
            try:
                metadata.version(name[0])
            except metadata.PackageNotFoundError:
                lacks.append(name[0])
    return missing


def as_text(facts: dict[str, Any], indent: str = "") -> str:
    """Nested facts as lines."""
    lines = []
    for name, value in facts.items():
        if name == "extras":
            lines += [f"{indent}extras"]
            for extra, lacks in value.items():
                mend = f'lacks {", ".join(lacks)}: pip install "riemlayer[{extra}]"'
                lines.append(f"{indent}  {extra}: {mend if lacks else 'complete'}")
        elif isinstance(value, dict):
            lines += [f"{indent}{name}", as_text(value, indent + "  ")]
        elif isinstance(value, list):
            lines.append(f"{indent}{name}: {', '.join(map(str, value)) or 'none'}")
        else:
            lines.append(f"{indent}{name}: {value}")
    return "\n".join(lines)


def bench(
    shape: Annotated[
        Path | None, typer.Argument(help="A torus if none.", show_default=False)
    ] = None,
    weights: Weights = "base",
    points: Annotated[int, typer.Option(help="Points of the cloud.", min=4)] = 10_000,
    repeats: Annotated[int, typer.Option(help="Runs, of which the median counts.", min=1)] = 5,
    threads: Annotated[int | None, typer.Option(help="Of torch; its own choice.", min=1)] = None,
    device: Device = "cpu",
) -> Answer:
    """Times of encode, Log and Exp on this machine."""
    import torch

    kept = torch.get_num_threads()
    torch.set_num_threads(threads or kept)
    try:
        facts = timed(shape, weights, points, repeats, device)
        facts["threads"] = torch.get_num_threads()
    finally:
        torch.set_num_threads(kept)
    lines = [f"{facts['points']:,} points, {facts['threads']} threads, {device}, medians"]
    lines += [f"{name:28} {value:9.2f} ms" for name, value in facts["milliseconds"].items()]
    return Answer(facts, "\n".join(lines))


def timed(
    shape: Path | None, weights: str, points: int, repeats: int, device: str
) -> dict[str, Any]:
    """Medians in milliseconds, and what they were measured on."""
    import torch

    if shape is None:
        stage("loading the field")
        field, cloud = load_field(weights, device), torus(points).to(device)
    else:
        surface = Encoding(shape, weights, points, device=device).load().surface
        field, cloud = surface.field, surface.points
    cloud = cloud.to(next(field.parameters()).dtype)
    surface = field.encode(cloud)
    p, v = cloud[0], 0.3 * torch.randn_like(cloud[:1000])
    tasks: dict[str, Callable[[], object]] = {
        "encode": lambda: field.encode(cloud),
        f"log of {len(cloud)} points": lambda: surface.log(p, cloud),
        f"exp of {len(v)} vectors": lambda: surface.exp(p, v),
    }
    times = {}
    for name, task in tasks.items():
        stage(name)
        task()
        times[name] = 1e3 * median(seconds(task, cloud.device) for _ in range(repeats))
    file = None if shape is None else str(shape)
    facts = {"shape": file, "points": len(cloud), "weights": weights, "device": device}
    return facts | {"repeats": repeats, "milliseconds": times}


def seconds(task: Callable[[], object], device: Any) -> float:
    """Of one run."""
    import torch

    if device.type == "cuda":
        torch.cuda.synchronize(device)
    start = time.perf_counter()
    task()
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter() - start


def torus(n: int):
    """(n, 3) random points of a torus."""
    import torch

    a, b = 2 * torch.pi * torch.rand(2, n, generator=torch.Generator().manual_seed(0))
    return torch.stack(((2 + b.cos()) * a.cos(), (2 + b.cos()) * a.sin(), b.sin()), -1)
