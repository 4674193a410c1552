"""Parts of articulated bodies by a U-Net of tangent convolutions, then trained into the field.

    python examples/segmentation_tangent_conv.py

Which points of a puppet in any pose are head, torso, arm, leg? First the field is frozen, then both
learn together, the field, which has learned before, slowly. Draws demo_output/segmentation.png.
"""

from __future__ import annotations

import argparse
import math
from copy import deepcopy
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from riemlayer import ExpLogField
from riemlayer.data.puppets import PARTS, puppet
from riemlayer.nn import Cells, GeodesicPool, GeodesicUnpool, TangentConv
from riemlayer.ops import LocalGeometry, local_geometry
from riemlayer.viz import Drawing, label_colours, viewpoint, write_png

LEG = PARTS.index("leg")
POOL, UNPOOL = GeodesicPool(ratio=0.15, reduce="max"), GeodesicUnpool()


class Cloud(NamedTuple):
    """A labelled cloud with the edges of all, of 15 % and of 2 % of its points."""

    points: Tensor
    part: Tensor
    x: Tensor
    geometry: list[LocalGeometry]
    cells: list[Cells]


def encode(field: ExpLogField, points: Tensor, part: Tensor, known=(None, None)) -> Cloud:
    """What the network wants to know of a cloud; cells that are known are kept."""
    surface = field.encode(points)
    geometry, cells = [local_geometry(surface, k=10)], []
    for old in known:
        cells.append(old or POOL.cells(geometry[-1]))
        surface = surface.at(cells[-1].index)
        geometry.append(local_geometry(surface, k=8))
    (sender, receiver), normal = geometry[0].edge_index, geometry[0].frame[..., 2]
    rise = ((points[sender] - points[receiver]) * normal[receiver]).sum(-1)
    bend = torch.zeros(len(points)).index_add(0, receiver, geometry[0].weight * rise)
    out = points - points.mean(0)  # the inputs say nothing of place or pose
    x = torch.stack((20 * bend, out.norm(dim=-1), (out * normal).sum(-1)), -1)
    return Cloud(points, part, x, geometry, cells)


class Segmenter(nn.Module):
    """A small U-Net."""

    def __init__(self) -> None:
        super().__init__()
        self.first, self.second = TangentConv(3, 32, 1, 6), TangentConv(32, 64, 1, 6)
        self.third, self.fourth = TangentConv(64, 64, 1, 6), TangentConv(64, 64, 1, 6)
        self.up = TangentConv(128, 64, 1, 6)
        self.head = nn.Sequential(nn.Linear(96, 64), nn.LayerNorm(64), nn.ReLU(), nn.Linear(64, 4))

    def forward(self, cloud: Cloud) -> Tensor:
        def active(x: Tensor) -> Tensor:
            return F.layer_norm(x, x.shape[1:]).relu()

        (fine, middle, coarse), (first, second) = cloud.geometry, cloud.cells
        a = active(self.first(cloud.x, fine))
        b = active(self.second(POOL(a, fine, first)[0], middle))
        c = active(self.third(POOL(b, middle, second)[0], coarse))
        c = c + active(self.fourth(c, coarse))
        b = active(self.up(torch.cat((b, UNPOOL(c, second)), 1), middle))
        return self.head(torch.cat((a, UNPOOL(b, first)), 1))


class Pointwise(nn.Sequential):
    """The baseline: each point alone."""

    def forward(self, cloud: Cloud) -> Tensor:
        return super().forward(cloud.x)


def fit(network, clouds: list[Cloud], steps: int, rate: float, field: ExpLogField | None = None):
    """The network, trained on frames turned at random; with it the field, if there is one."""
    parts, rates = ([network], [rate]) if field is None else ([network, field], [rate, rate / 50])
    optimiser = torch.optim.AdamW([{"params": [*x.parameters()]} for x in parts])
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rates, total_steps=steps)
    for step in range(steps):
        cloud = clouds[step % len(clouds)]
        if field is not None:
            cloud = encode(field, cloud.points, cloud.part, cloud.cells)
        geometry = [g.turned(2 * torch.pi * torch.rand(g.points)) for g in cloud.geometry]
        optimiser.zero_grad()
        F.cross_entropy(network(cloud._replace(geometry=geometry)), cloud.part).backward()
        optimiser.step()
        schedule.step()
    return network


@torch.no_grad()
def report(name: str, network, clouds: list[Cloud]) -> Tensor:
    """The parts (clouds, N) that the network sees; prints the share that is right."""
    seen, truth = zip(*((network(cloud).argmax(-1), cloud.part) for cloud in clouds), strict=True)
    print(f"{name:45}{float((torch.cat(seen) == torch.cat(truth)).float().mean()):.3f}", flush=True)
    return torch.stack(seen)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fast", action="store_true", help="few puppets, few steps")
    fast = parser.parse_args().fast
    torch.manual_seed(0)
    known, new, count, steps, more = (10, 5, 400, 120, 3) if fast else (80, 24, 800, 160, 80)
    print(f"learned from {known} puppets; share of the points of {new} others that is right:")
    field, network = ExpLogField.from_pretrained("base").requires_grad_(False), Segmenter()
    bodies = [[*map(torch.from_numpy, puppet(seed, count))] for seed in range(known + new)]
    clouds = [encode(field, points, part) for points, part in bodies]
    clouds, held = clouds[:known], clouds[known:]
    report("always leg, the most frequent", lambda c: F.one_hot(0 * c.part + LEG), held)
    alone = Pointwise(nn.Linear(3, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU(), nn.Linear(64, 4))
    guess = report("each point alone", fit(alone, clouds, steps, 5e-3), held)
    report("network before training", network, held)
    report(f"{steps} steps, field frozen", fit(network, clouds, steps, 1e-2), held)
    report(f"{more} more, field still frozen", fit(deepcopy(network), clouds, more, 2e-3), held)
    fit(network, clouds, more, 2e-3, field.requires_grad_(True))
    norm = float(nn.utils.clip_grad_norm_(field.backbone.parameters(), math.inf))
    assert 0 < norm < math.inf, "the loss does not reach the backbone"
    held = [encode(field.requires_grad_(False), points, part) for points, part in bodies[known:]]
    answer = report(f"{more} more instead, network and field", network, held)
    print(f"{'norm of the last gradient in the backbone':45}{norm:.2g}")
    x = np.stack([puppet(known + i, count, turned=False)[0][:, [0, 2, 1]] for i in range(4)])
    x += np.array([[0, 0, 0], [1.4, 0, 0], [0, 1.8, 0], [1.4, 1.8, 0]], x.dtype)[:, None]
    points, truth, drawings = x.reshape(-1, 3), torch.stack([c.part for c in held[:4]]), []
    named = {"true parts": truth, "each point alone": guess[:4], "tangent convolutions": answer[:4]}
    for name, part in named.items():
        name += "" if part is truth else f": {(part == truth).float().mean():.0%} right"
        drawings.append(Drawing(points, colours=label_colours(part.flatten()), title=name))
    (path := Path("demo_output/segmentation.png")).parent.mkdir(exist_ok=True)
    view = viewpoint(points, [0.0, 0.0, 1.0], tilt=0)
    print("picture:", write_png(path, *drawings, view=view, size=240 if fast else 500))


if __name__ == "__main__":
    main()
