"""What relief does a pebble have? Convolutions on the surface, pooled over geodesic cells.

    python examples/classification_geodesic_pool.py

Pebbles of random form, size and pose carry waves, checks, zigzags or spots. The network is told of
each point whether the surface bends more or less there than at the pebble's other points: the same
numbers for each pebble, so what counts is how they lie beside each other. The field is frozen; each
batch is encoded once, cells included. The picture is demo_output/classification.png.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, layer_norm

from riemlayer import ExpLogField
from riemlayer.nn import Cells, GeodesicConv, GeodesicPool
from riemlayer.ops import LocalGeometry, local_geometry
from riemlayer.viz import Drawing, label_colours, viewpoint, write_png

RELIEFS = ("waves", "checks", "zigzags", "spots")
PACK, POOL = 8, GeodesicPool(ratio=0.12, reduce="max")


class Pack(NamedTuple):
    """Eight pebbles packed into one cloud, with the edges of all points and of those kept."""

    label: Tensor
    place: Tensor  # (8, N, 3), centred and of one size
    x: Tensor
    fine: LocalGeometry
    cells: Cells
    coarse: LocalGeometry


def pebble(seed: int, count: int) -> np.ndarray:
    """Points (count, 3) of a pebble with relief `seed % 4`."""
    rng = np.random.default_rng(seed)
    h, angle = np.linspace(-1, 1, count), np.pi * (3 - 5**0.5) * np.arange(count)
    u = np.stack((np.cos(angle) * (1 - h**2) ** 0.5, np.sin(angle) * (1 - h**2) ** 0.5, h), -1)
    u += rng.normal(0, 0.5 / count**0.5, u.shape)
    turn, shift = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.uniform(0, 2 * np.pi, 50)
    wave = rng.uniform(9, 11)
    a, b = (wave * u @ turn[:2].T + shift[:2]).T
    ways = rng.normal(size=(3, 50))
    spots = np.cos(wave * u @ (ways / np.linalg.norm(ways, axis=0)) + shift).sum(-1)
    zigzags = np.sin(a + 1.5 * np.arcsin(np.sin(b / 2)))
    relief = (np.sin(a), np.sin(a) * np.sin(b), zigzags, spots)[seed % 4]
    height = relief.argsort().argsort() / count - 0.5  # spread in the same way whatever the relief
    form = 1 + 0.08 * np.sin(u @ rng.normal(0, 2, (3, 4)) + shift[2:6]).sum(-1)
    x = u / np.linalg.norm(u, axis=-1, keepdims=True) * (form + 0.15 * height)[:, None]
    x *= rng.uniform(0.5, 2) * rng.uniform(0.7, 1, 3)
    return (x @ np.linalg.qr(rng.normal(size=(3, 3)))[0]).astype(np.float32)


@torch.no_grad()
def pack(field: ExpLogField, first: int, count: int) -> Pack:
    """What the networks want to know of the pebbles from number `first` on."""
    seeds = torch.arange(first, first + PACK)
    points = torch.from_numpy(np.concatenate([pebble(int(seed), count) for seed in seeds]))
    surface = field.encode(points, torch.arange(PACK).repeat_interleave(count))
    fine = local_geometry(surface, k=12)
    cells = POOL.cells(fine)
    sender, receiver = fine.edge_index
    rise = ((points[sender] - points[receiver]) * fine.frame[receiver, :, 2]).sum(-1)
    bend = torch.zeros(len(points)).index_add(0, receiver, fine.weight * rise)
    rank = bend.view(PACK, count).argsort(1).argsort(1).view(-1, 1) / count
    place = points.view(PACK, count, 3)
    place = (place - place.mean(1, keepdim=True)) / place.std((1, 2), keepdim=True)
    coarse = local_geometry(surface.at(cells.index), k=10)
    return Pack(seeds % 4, place, 4 * rank - 2, fine, cells, coarse)


class Classifier(nn.Module):
    """Two convolutions, pooling, another, and the mean of what is left of each pebble."""

    def __init__(self) -> None:
        super().__init__()
        self.first, self.second = GeodesicConv(1, 16, 2, 8), GeodesicConv(16, 32, 2, 8)
        self.third, self.head = GeodesicConv(32, 64, 1, 8), nn.Linear(64, 4)

    def forward(self, pack: Pack) -> Tensor:
        x = layer_norm(self.first(pack.x, pack.fine), (16,)).relu()
        x = layer_norm(self.second(x, pack.fine), (32,)).relu()
        x, _ = POOL(x, pack.fine, pack.cells)
        x = layer_norm(self.third(x, pack.coarse), (64,)).relu()
        return self.head(x.unflatten(0, (PACK, -1)).mean(1))


class Pointwise(nn.Sequential):
    """The baseline: place and bend of each point alone, and the mean of what they say."""

    def forward(self, pack: Pack) -> Tensor:
        return super().forward(torch.cat((pack.place, pack.x.view(PACK, -1, 1)), -1)).mean(1)


def learn(name: str, network: nn.Module, packs: list[Pack], new: list[Pack], steps: int) -> Tensor:
    """Counts (4, 4) of new pebbles by relief and by what they are taken for, after training."""
    optimiser = torch.optim.AdamW(network.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 5e-3, total_steps=steps)
    for step in range(steps):
        batch = packs[step % len(packs)]
        optimiser.zero_grad()
        cross_entropy(network(batch), batch.label).backward()
        optimiser.step()
        schedule.step()
    with torch.no_grad():
        pairs = torch.cat([4 * p.label + network(p).argmax(-1) for p in new])
    table = pairs.bincount(minlength=16).view(4, 4)
    print(f"{name:34}{float(table.trace() / table.sum()):.3f}", flush=True)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fast", action="store_true", help="few pebbles, few steps")
    fast = parser.parse_args().fast
    torch.manual_seed(0)
    known, new, count, steps = (3, 1, 400, 20) if fast else (20, 12, 800, 200)
    field = ExpLogField.from_pretrained("base").requires_grad_(False)
    packs = [pack(field, PACK * i, count) for i in range(known + new)]
    print(f"learned from {PACK * known} pebbles; share of {PACK * new} others that is right:")
    flat = []
    for p in packs:
        fine, coarse = (g._replace(theta=0 * g.theta) for g in (p.fine, p.coarse))
        flat.append(p._replace(fine=fine, coarse=coarse))
    alone = Pointwise(nn.Linear(4, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU(), nn.Linear(64, 4))
    learn("each point alone (chance: 0.250)", alone, packs[:known], packs[known:], steps)
    learn("the network without directions", Classifier(), flat[:known], flat[known:], steps)
    table = learn("the network", Classifier(), packs[:known], packs[known:], steps)
    print(f"rows: {', '.join(RELIEFS)}; columns: what they are taken for\n{table.numpy()}")
    shown, corners = packs[known], 4.5 * torch.tensor([[0, 1, 0], [1, 1, 0], [0, 0, 0], [1, 0, 0]])
    points = (shown.place[:4] + corners[:, None]).flatten(0, 1)
    colours = label_colours(shown.cells.assignment[: len(points)])
    told = Drawing(points, values=shown.x[: len(points), 0], label="bend", title=", ".join(RELIEFS))
    cells = Drawing(points, colours=colours, title="geodesic cells")
    path, view = Path("demo_output/classification.png"), viewpoint(points, [0.0, 0.0, 1.0], tilt=0)
    path.parent.mkdir(exist_ok=True)
    print("picture:", write_png(path, told, cells, view=view, size=240 if fast else 480))


if __name__ == "__main__":
    main()
