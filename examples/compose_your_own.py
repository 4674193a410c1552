"""Your own module with a log map in the middle, trained by a plain torch loop.

    python examples/compose_your_own.py

The task: from scattered samples of a function on a surface, its value at any other point. The
network sees each sample in log-map coordinates of the query, so distances are geodesic, and the
gradient runs through `surface.log` into the field.
"""

from __future__ import annotations

import argparse

import torch
from torch import Tensor, nn

from riemlayer import EncodedSurface, ExpLogField
from riemlayer.data.load import sample_mesh
from riemlayer.data.procedural import random_shape


class GeodesicInterpolation(nn.Module):
    """Attention over samples, by where they lie in the query's tangent plane."""

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        self.score = nn.Sequential(nn.Linear(2, width), nn.GELU(), nn.Linear(width, 1))

    def forward(self, surface: EncodedSurface, query: Tensor, at: Tensor, value: Tensor) -> Tensor:
        """Values (Q,) at queries (Q, 3) from values (S,) at samples (S, 3)."""
        v = surface.log(query[:, None], at)  # (Q, S, 3)
        r = surface.norm(query[:, None], v)
        features = torch.stack((r, (at - query[:, None]).norm(dim=-1)), -1)
        weight = torch.softmax(self.score(features).squeeze(-1) - 20 * r, -1)
        return weight @ value


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fast", action="store_true", help="few steps on few points")
    fast = parser.parse_args().fast
    torch.manual_seed(0)
    shape = random_shape(1_000_004, "toy")
    points = torch.from_numpy(
        sample_mesh(shape.vertices, shape.faces, 2000 if fast else 6000).points
    )
    field, network = ExpLogField.from_pretrained("base"), GeodesicInterpolation()
    parameters = [*network.parameters(), *field.log_head.parameters()]
    optimiser = torch.optim.Adam(parameters, 1e-3)
    truth = torch.sin(6 * points).sum(-1)
    for step in range(3 if fast else 60):
        mixed = torch.randperm(len(points))
        query, at = mixed[:128], mixed[128:384]
        surface = field.encode(points)
        answer = network(surface, points[query], points[at], truth[at])
        loss = (answer - truth[query]).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if step % 10 == 0 or fast:
            print(f"step {step:3d}  mean squared error {float(loss.detach()):.4f}")


if __name__ == "__main__":
    main()
