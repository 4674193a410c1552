"""A network of tangent convolutions on edges with log maps from anywhere, and what it learns."""

from __future__ import annotations

from statistics import mean
from typing import NamedTuple, Self

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from benchmarks.labelled import CLASSES, Labelled
from benchmarks.log_edges import Logs, mesh_normals
from riemlayer.geometry import angle_of, frame_of
from riemlayer.nn import TangentConv
from riemlayer.nn.polar import polar_shares
from riemlayer.nn.sums import Sums
from riemlayer.numerics import falloff, segment_sum
from riemlayer.ops import LocalGeometry

RADIUS = 0.2
NEIGHBOURS = 24
RINGS, ANGLES = 2, 6
TASKS = {"few labels": ("figure", "sheet"), "coordinates": ("figure",)}
"""And the kinds of shapes that each is learned on."""
KNOWN, WRONG = 0.05, 0.15
"""Share of points that carry a label, and of those a wrong one."""


class Graph(NamedTuple):
    """A shape with the edges that all methods share."""

    shape: Labelled
    points: Tensor
    frame: Tensor
    edge_index: Tensor
    """(2, E) neighbour, receiver."""
    label: Tensor


def graph(shape: Labelled, seed: int) -> Graph:
    """Up to 24 neighbours within the radius of each point; frames upright about mesh normals."""
    points = torch.from_numpy(shape.vertices).float()
    chord = torch.cdist(points, points).fill_diagonal_(torch.inf)
    generator = torch.Generator().manual_seed(seed)
    order = torch.where(chord < RADIUS, torch.rand(chord.shape, generator=generator), torch.inf)
    drawn, sender = order.topk(min(NEIGHBOURS, len(points) - 1), largest=False)
    receiver = torch.arange(len(points))[:, None].expand_as(sender)
    kept = drawn.isfinite()
    edges = torch.stack((sender[kept], receiver[kept]))
    frame = upright(mesh_normals(shape).float())
    return Graph(shape, points, frame, edges, torch.from_numpy(shape.label).long())


def upright(normal: Tensor) -> Tensor:
    """Frames (N, 3, 3) whose second axis points up as far as the tangent plane allows."""
    up = normal.new_tensor([0.0, 0.0, 1.0]).expand_as(normal)
    flat = up - (up * normal).sum(-1, keepdim=True) * normal
    length = flat.norm(dim=-1, keepdim=True)
    second = torch.where(length > 0.05, flat / length.clamp_min(0.05), frame_of(normal)[..., 1])
    return torch.stack((torch.linalg.cross(second, normal), second, normal), -1)


def geometry(graph: Graph, logs: Logs) -> LocalGeometry:
    """What the layers take: the method's logs in the frames that all share.

    Turning a log into another plane keeps its length.
    """
    receiver = graph.edge_index[1]
    length = logs.vector.norm(dim=-1)
    x = (logs.vector[:, None] @ graph.frame[receiver, :, :2]).squeeze(1)
    x = x * (length / x.norm(dim=-1).clamp_min(1e-9))[:, None]
    kept = logs.valid & (length < RADIUS)
    weight = torch.where(kept, falloff(length / RADIUS), 0)
    count = len(graph.points)
    total = segment_sum(weight[:, None], receiver, count).squeeze(-1)
    return LocalGeometry(
        edge_index=graph.edge_index, log=x, r=length.clamp_max(RADIUS), theta=angle_of(x),
        transport=torch.zeros_like(length), weight=weight / total[receiver].clamp_min(1e-9),
        valid=kept, frame=graph.frame, radius=torch.full((count,), RADIUS),
        batch=torch.zeros(count, dtype=torch.long),
    )  # fmt: skip


class Patches(NamedTuple):
    """Where each neighbour counts on the kernels' grid: it does not change during training."""

    there: Sums
    back: Sums
    """The transpose, for the gradient."""
    share: Tensor

    @classmethod
    def of(cls, geometry: LocalGeometry) -> Self:
        """What `TangentConv` works out anew in each call."""
        index, share = polar_shares(geometry, RINGS, ANGLES)
        nodes, n = 1 + RINGS * ANGLES, geometry.points
        sender, receiver = geometry.edge_index
        row = receiver[:, None] * nodes + index
        point = sender[:, None].expand_as(row)
        share = geometry.weight[:, None] * share
        return cls(Sums.of(point, row, n * nodes), Sums.of(row, point, n), share)


class Gather(torch.autograd.Function):
    """Sums over the grid, linear in the features."""

    @staticmethod
    def forward(ctx, x: Tensor, patches: Patches) -> Tensor:
        ctx.patches = patches
        return patches.there.weighted(x, patches.share)

    @staticmethod
    def backward(ctx, grad: Tensor):
        return ctx.patches.back.weighted(grad, ctx.patches.share), None


class PatchConv(TangentConv):
    """`TangentConv` on prepared patches: the same answer several times faster."""

    def forward(self, x: Tensor, patches: Patches) -> Tensor:
        pooled = torch.as_tensor(Gather.apply(x, patches)).view(len(x), -1, x.shape[1])
        kernel = self.kernel.flatten(0, 2)
        return self.centre(x + pooled[:, 0]) + pooled[:, 1:].flatten(1) @ kernel


class Segmenter(nn.Module):
    """Three tangent convolutions, each after the first on top of what it was given."""

    def __init__(self, inputs: int, width: int = 16) -> None:
        super().__init__()
        widths = (inputs, width, width)
        self.convs = nn.ModuleList(PatchConv(c, width, RINGS, ANGLES) for c in widths)
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in widths)
        self.last = nn.Linear(width, CLASSES)

    def forward(self, x: Tensor, patches: Patches) -> Tensor:
        for i, (conv, norm) in enumerate(zip(self.convs, self.norms, strict=True)):
            y = norm(conv(x, patches)).relu()
            x = x + y if i else y
        return self.last(x)


class Question(NamedTuple):
    """Inputs (N, C) of a shape, its answers (N,) and the points (N,) that are asked for."""

    x: Tensor
    label: Tensor
    asked: Tensor


def question(task: str, graph: Graph, generator: torch.Generator) -> Question:
    """A shape as the network is shown it: turned about the vertical, or with labels at random."""
    n = len(graph.points)
    if task == "coordinates":
        angle = 2 * torch.pi * torch.rand((), generator=generator)
        c, s, o, i = angle.cos(), angle.sin(), torch.tensor(0.0), torch.tensor(1.0)
        turn = torch.stack((c, -s, o, s, c, o, o, o, i)).view(3, 3)
        return Question(graph.points @ turn.T, graph.label, torch.ones(n, dtype=torch.bool))
    names = torch.randperm(CLASSES, generator=generator)  # what counts is that labels agree
    label = names[graph.label]
    known = torch.rand(n, generator=generator) < KNOWN
    wrong = torch.rand(n, generator=generator) < WRONG
    other = torch.randint(CLASSES, (n,), generator=generator)
    told = F.one_hot(torch.where(wrong, other, label), CLASSES) * known[:, None]
    return Question(torch.cat((told, known[:, None]), -1).float(), label, ~known)


Example = tuple[Graph, Patches]


def learn(task: str, train: list[Example], test: list[Example], epochs: int, seed: int) -> dict:
    """Accuracy on the test shapes of each kind, after training from a seed."""
    torch.manual_seed(seed)
    generator = torch.Generator().manual_seed(seed)
    network = Segmenter(3 if task == "coordinates" else CLASSES + 1)
    optimiser = torch.optim.AdamW(network.parameters(), 5e-3)
    steps = epochs * len(train)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 5e-3, total_steps=steps)
    for step in range(steps):
        if step % len(train) == 0:
            order = torch.randperm(len(train), generator=generator).tolist()
        own, patches = train[order[step % len(train)]]
        asked = question(task, own, generator)
        loss = F.cross_entropy(network(asked.x, patches)[asked.asked], asked.label[asked.asked])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    right: dict[str, list[float]] = {}
    generator = torch.Generator().manual_seed(1_000 + seed)
    with torch.inference_mode():
        for own, patches in test:
            asked = question(task, own, generator)
            hit = network(asked.x, patches).argmax(-1) == asked.label
            right.setdefault(own.shape.kind, []).append(float(hit[asked.asked].float().mean()))
    return {kind: mean(values) for kind, values in right.items()}
