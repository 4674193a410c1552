"""Kernels on the tangent disc, given at the nodes of a polar grid and linear between them."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from riemlayer.nn.arguments import check_features, check_sizes
from riemlayer.nn.sums import Sums
from riemlayer.ops import LocalGeometry


class PolarConv(nn.Module):
    """What the convolutions on a polar grid share: a kernel K and its grid.

    K(u) is a matrix (inputs, outputs) for each place u of the unit disc, a receiver's neighbourhood
    shrunk by its radius R. It is given at the centre and at `angles` directions on each of `rings`
    circles, the last of which is the border; linear in radius and angle between these nodes, so it
    is continuous, and one matrix at the centre.
    """

    def __init__(self, inputs: int, outputs: int, rings: int = 2, angles: int = 8) -> None:
        super().__init__()
        check_sizes(inputs=inputs, outputs=outputs, rings=rings, angles=angles)
        self.centre = nn.Linear(inputs, outputs)
        # each node sees 1 / (rings angles) of a neighbourhood: together they start as one Linear
        scale = math.sqrt(rings * angles / (3 * inputs))
        self.kernel = nn.Parameter(scale * torch.randn(rings, angles, inputs, outputs))

    def gather(self, x: Tensor, geometry: LocalGeometry) -> tuple[Tensor, Tensor]:
        """Features summed at the nodes with the weights of Eq. (9).

        Returns:
            At the centre (N, inputs), where the receiver itself counts with weight 1, and on the
            rings (N, rings * angles * inputs).
        """
        rings, angles, inputs, _ = self.kernel.shape
        check_features(x, geometry, inputs)
        nodes = 1 + rings * angles
        index, share = polar_shares(geometry, rings, angles)
        sender, receiver = geometry.edge_index
        row = receiver[:, None] * nodes + index
        sums = Sums.of(sender[:, None].expand_as(row), row, geometry.points * nodes)
        pooled = sums.weighted(x, geometry.weight[:, None] * share)
        pooled = pooled.view(geometry.points, nodes, inputs)
        return x + pooled[:, 0], pooled[:, 1:].flatten(1)

    def extra_repr(self) -> str:
        rings, angles, inputs, outputs = self.kernel.shape
        return f"{inputs} -> {outputs}, rings={rings}, angles={angles}"


def angular_max(patch: Tensor, kernel: Tensor) -> Tensor:
    """max_s sum_{k, a} K[k, a - s] patch[k, a] over the turns s of a grid, for each output.

    Args:
        patch: (N, rings * angles * inputs).
        kernel: (rings, angles, inputs, outputs).

    Shapes: -> (N, outputs).
    """
    angles = kernel.shape[1]
    turns = torch.stack([kernel.roll(s, 1) for s in range(angles)], 3)  # (K, A, C, turns, D)
    response = patch @ turns.flatten(3).flatten(0, 2)
    return response.view(len(patch), angles, -1).amax(1)


def polar_shares(geometry: LocalGeometry, rings: int, angles: int) -> tuple[Tensor, Tensor]:
    """Nodes (E, 4) around each neighbour, the centre being 0, and its shares (E, 4) in them.

    A share falls linearly, in radius and in angle, from 1 at its node to 0 at the next; the four
    of an edge sum to 1.
    """
    ring, along = ring_shares(geometry, rings)
    turn = geometry.theta * (angles / (2 * math.pi))
    low = turn.floor()
    part = turn - low
    direction = torch.stack((low, low + 1), -1).long() % angles  # (E, 2)
    around = torch.stack((1 - part, part), -1)
    index = 1 + (ring[..., None] - 1) * angles + direction[:, None]  # (E, 2, 2)
    index = torch.where(ring[..., None] > 0, index, 0)
    return index.flatten(1), (along[..., None] * around[:, None]).flatten(1)


def ring_shares(geometry: LocalGeometry, rings: int) -> tuple[Tensor, Tensor]:
    """Circles (E, 2) around each neighbour, the centre being 0, and its shares (E, 2) in them."""
    radius = geometry.radius[geometry.edge_index[1]].clamp_min(1e-12)
    depth = rings * (geometry.r / radius).clamp_max(1)
    low = depth.floor().clamp_max(rings - 1)
    part = depth - low
    ring = torch.stack((low, low + 1), -1).long()
    return ring, torch.stack((1 - part, part), -1)
