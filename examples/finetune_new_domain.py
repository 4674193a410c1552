"""Carry the packaged field to your own domain: before and after, on shapes it never saw.

    python examples/finetune_new_domain.py                      # a domain that is shipped: vessels
    python examples/finetune_new_domain.py --meshes DIR         # your meshes, of any quality
    python examples/finetune_new_domain.py --keep 0.01          # ... and stay near the old weights

Every fifth mesh is held out. The others are prepared and traced once (cached in demo_output/), the
heads train at once and the backbone later. What was known before is measured on shapes of the
general generator. Writes demo_output/finetune.md, .png, and the tuned weights, finetuned/.
"""

from __future__ import annotations

import argparse
from datetime import timedelta
from functools import partial
from pathlib import Path

import lightning as L
import torch
from lightning.pytorch.callbacks import TQDMProgressBar

from lightning_modules import ExpLogDataModule, ExpLogFineTuning, ExponentialAverage
from riemlayer import ExpLogField
from riemlayer.baselines import Neural, TrueLog
from riemlayer.data.domains import DOMAINS, write_domain
from riemlayer.data.prepare import find_meshes, prepare_meshes
from riemlayer.tables.evaluate import Shape, evaluate, pool, summarise
from riemlayer.tables.shapes import prepare_shapes, procedural_shapes
from riemlayer.viz import Canvas, draw_log, viewpoint, write_png


def main() -> None:
    args = arguments()
    cache = args.output / ("meshes" if args.meshes else args.domain)
    meshes = domain(args, cache)
    training, held_out = cache / "training", cache / "held_out"
    held = meshes[::5]
    prepare_meshes([m for m in meshes if m not in held], training, workers=args.workers)
    new, old = measured(args, held, held_out)
    before = ExpLogField.from_pretrained(args.weights)
    after = tune(args, training)
    table = report(before, after, {"new domain": new, "old domain": old})
    text = (
        f"{args.meshes.name if args.meshes else args.domain}: {len(meshes) - len(held)} meshes, "
        f"{args.minutes:g} minutes, keep {args.keep:g}, threads: {torch.get_num_threads()}. "
        f"Means over {len(new)} meshes that were held out.\n\n{table}\n"
    )
    print(f"\n{text}")
    (args.output / "finetune.md").write_text(text)
    print("picture:", picture(args, before, after, new[0]))
    after.save_pretrained(args.output / "finetuned")
    print("weights:", args.output / "finetuned")


def domain(args: argparse.Namespace, cache: Path) -> list[Path]:
    """Meshes of the user's folder, or of a shipped domain."""
    if args.meshes:
        return find_meshes(args.meshes)[: args.shapes]
    return write_domain(args.domain, args.shapes, cache / "meshes")


def measured(
    args: argparse.Namespace, held: list[Path], folder: Path
) -> tuple[list[Shape], list[Shape]]:
    """Held-out shapes of the new domain, and shapes of the old one, with their ground truth."""
    links = folder / "meshes"
    links.mkdir(parents=True, exist_ok=True)
    for path in held:
        link = links / f"{path.parent.name}-{path.name}"
        if not link.exists():
            link.symlink_to(path.resolve())
    prepare_shapes(links, folder / "shapes", sources=args.sources, workers=args.workers)
    known = args.output / "old_domain"
    procedural_shapes(args.known, known, sources=args.sources, workers=args.workers)
    return tuple(  # pyright: ignore[reportReturnType]
        [Shape.load(path) for path in sorted(root.glob("*/*.npz"))]
        for root in (folder / "shapes", known)
    )


def tune(args: argparse.Namespace, training: Path) -> ExpLogField:
    """The field after `args.minutes` of fine-tuning, averaged over the last steps."""
    L.seed_everything(0, verbose=False)
    model = ExpLogFineTuning(args.weights, keep=args.keep)
    average = ExponentialAverage(0.99)
    native = torch.cpu._is_avx512_bf16_supported()
    trainer = L.Trainer(
        accelerator="cpu",
        precision="bf16-mixed" if native else "32-true",
        max_time=timedelta(minutes=args.minutes),
        max_epochs=-1,
        gradient_clip_val=1.0,
        limit_val_batches=0,
        logger=False,
        enable_checkpointing=False,
        enable_model_summary=False,
        callbacks=[average, TQDMProgressBar(refresh_rate=20)],
    )
    data = ExpLogDataModule([str(training)], sources=26, vectors=384, validation=0)
    trainer.fit(model, datamodule=data)
    model.field.load_state_dict(average.average)
    return model.field.eval()


def report(before: ExpLogField, after: ExpLogField, domains: dict[str, list[Shape]]) -> str:
    """Errors within the trained radius, means over all sources, in Markdown.

    On a curved surface the true log map has errors, too: the floor of every method.
    """
    lines = ["| | | before | after | change | floor |", "|---|---|--:|--:|--:|--:|"]
    for domain, shapes in domains.items():
        a, b, floor = (
            summarise(pool([evaluate(system(), shape) for shape in shapes]))["r0.5"]
            for system in (partial(Neural, before), partial(Neural, after), TrueLog)
        )
        for name, key in (("E_angle (degrees)", "angle"), ("Log end", "log_end"), ("E_Exp", "exp")):
            change = f"{a[key]:.4g} | {b[key]:.4g} | {b[key] / a[key] - 1:+.1%}"
            lines.append(f"| {domain} | {name} | {change} | {floor.get(key, 0):.4g} |")
    return "\n".join(lines)


def picture(args: argparse.Namespace, before: ExpLogField, after: ExpLogField, shape: Shape) -> str:
    """The log map of one source of a held-out shape, before and after."""
    points = torch.from_numpy(shape.points).float()
    canvas = Canvas(shape.V, shape.F)
    p = torch.from_numpy(shape.V[shape.src[0]]).float()
    drawings = [
        draw_log(field.encode(points), p, canvas, title=title)
        for field, title in ((before, "before"), (after, "after"))
    ]
    view = viewpoint(shape.V, shape.src_normal[0], tilt=0.3)
    return str(write_png(args.output / "finetune.png", *drawings, view=view, size=args.pixels))


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--meshes", type=Path, help="folder of your meshes")
    parser.add_argument("--domain", choices=[*DOMAINS], default="vessels")
    parser.add_argument("--shapes", type=int, default=60, help="meshes to use at most")
    parser.add_argument("--minutes", type=float, default=15, help="of training")
    parser.add_argument("--keep", type=float, default=0.0, help="weight of |w - first w|^2")
    parser.add_argument("--weights", default="base")
    parser.add_argument("--workers", type=int, default=2, help="processes that prepare meshes")
    parser.add_argument("--output", type=Path, default=Path("demo_output"))
    parser.add_argument("--fast", action="store_true", help="a few seconds of everything")
    args = parser.parse_args()
    args.sources, args.known, args.pixels = (2, 1, 200) if args.fast else (10, 10, 600)
    if args.fast:
        args.shapes, args.minutes, args.workers = 5, 0.1, 1
    return args


if __name__ == "__main__":
    main()
