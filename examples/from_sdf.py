"""Fig. 9 of the paper: from a neural signed distance function to Exp and Log, without a mesh.

    python examples/from_sdf.py [--steps 1500]

A small network learns the signed distance of a procedural shape; its zero level is sampled by
Eq. (7) and encoded. The cloud, a log map and a fan of geodesics are drawn to
demo_output/from_sdf.png.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor, nn

from riemlayer import ExpLogField
from riemlayer.data import sample_sdf
from riemlayer.data.manifold import vertex_normals
from riemlayer.data.meshes import normalise
from riemlayer.data.procedural import random_shape
from riemlayer.data.sampling import sample_surface
from riemlayer.viz import Canvas, Drawing, draw_exp, draw_log, outward, viewpoint, write_png

BOUNDS = (-1.1, 1.1)
OCTAVES = 4
CLAMP = 0.1
"""Distances beyond that are learned by their sign and not by their size."""


def main() -> None:
    args = arguments()
    torch.manual_seed(0)
    shape = random_shape(1_000_003, "vessel")
    vertices, _, _ = normalise(shape.vertices)
    start = time.perf_counter()
    net = train(vertices, shape.faces, steps=150 if args.fast else args.steps)
    took = time.perf_counter() - start

    points, _, residual = sample_sdf(net, 2_000 if args.fast else 12_000, BOUNDS)
    dense = sample_surface(vertices, shape.faces, 200_000, np.random.default_rng(1))
    off = KDTree(dense).query(points.numpy())[0]
    print(f"trained for {took:.0f} s; {len(points):,} points of the zero level by Eq. (7)")
    print(f"|f| there: mean {residual.mean():.1e}, largest {residual.max():.1e}")
    middle, most = np.quantile(off, (0.5, 0.95))
    print(f"distance from the true surface: median {middle:.4f}, 95 % within {most:.4f}")

    with torch.no_grad():
        surface = ExpLogField.from_pretrained(args.weights).encode(points)
        p = points[points[:, 2].argmax()]
        canvas = Canvas(points)
        drawings = [
            Drawing(canvas, title="neural SDF, Eq. (7)"),
            draw_log(surface, p, canvas),
            draw_exp(surface, p, canvas),
        ]
        view = viewpoint(points, outward(points, p, surface.normal(p)))
    args.output.mkdir(parents=True, exist_ok=True)
    size = 240 if args.fast else 640
    print("picture:", write_png(args.output / "from_sdf.png", *drawings, view=view, size=size))


class NeuralSDF(nn.Module):
    """Signed distance (Q,) at points (Q, 3): sines and cosines of the point, then an MLP."""

    def __init__(self, width: int = 96) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(3 + 6 * OCTAVES, width), nn.Softplus(50),
            nn.Linear(width, width), nn.Softplus(50),
            nn.Linear(width, width), nn.Softplus(50),
            nn.Linear(width, 1),
        )  # fmt: skip

    def forward(self, x: Tensor) -> Tensor:
        waves = x[:, None] * 2.0 ** torch.arange(OCTAVES, device=x.device)[:, None]  # (Q, O, 3)
        features = torch.cat((x, waves.sin().flatten(1), waves.cos().flatten(1)), -1)
        return self.layers(features).squeeze(-1)


def train(vertices: np.ndarray, faces: np.ndarray, steps: int, batch: int = 2048) -> NeuralSDF:
    """The network after `steps` steps on true distances near the surface and in the cube."""
    x, distance = supervision(vertices, faces)
    net = NeuralSDF()
    optimiser = torch.optim.Adam(net.parameters(), 3e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 6e-3, total_steps=steps)
    for _ in range(steps):
        index = torch.randint(len(x), (batch,))
        answer, truth = net(x[index]), distance[index]
        loss = (answer.clamp(-CLAMP, CLAMP) - truth.clamp(-CLAMP, CLAMP)).abs().mean()
        loss = loss + 0.1 * (answer - truth).abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return net.eval().requires_grad_(False)


def supervision(vertices: np.ndarray, faces: np.ndarray) -> tuple[Tensor, Tensor]:
    """Points (M, 3) and their signed distances: to the nearest sample, negative behind it."""
    rng = np.random.default_rng(0)
    samples = sample_surface(vertices, faces, 60_000, rng)
    normals = vertex_normals(vertices, faces)[KDTree(vertices).query(samples)[1]]
    near = samples + rng.normal(size=(60_000, 3)) * rng.choice([0.01, 0.05], (60_000, 1))
    x = np.concatenate([near, rng.uniform(*BOUNDS, size=(20_000, 3))])
    distance, index = KDTree(samples).query(x)
    side = ((x - samples[index]) * normals[index]).sum(1)
    signed = np.where(distance < 0.02, side, np.copysign(distance, side))
    return torch.from_numpy(x).float(), torch.from_numpy(signed).float()


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=1500, help="of the network's training")
    parser.add_argument("--weights", default="base")
    parser.add_argument("--output", type=Path, default=Path("demo_output"))
    parser.add_argument("--fast", action="store_true", help="fewer steps and points")
    return parser.parse_args()


if __name__ == "__main__":
    main()
