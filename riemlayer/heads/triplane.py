"""Hyper-modulated triplanes (Sec. 3.2): an embedding makes three planes, queries sample them."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from riemlayer.numerics import weighted_rows

PLANES = ((0, 1), (0, 2), (1, 2))
"""Coordinates of the planes xy, xz, yz."""


def sample_triplane(planes: Tensor, x: Tensor) -> Tensor:
    """Bilinear features of queries on three planes (Sec. 3.2, step 2).

    Gather-based, because `F.grid_sample` has no forward-mode derivative. Corners are aligned: -1
    and 1 are the outermost samples. A query outside [-1, 1] takes the value at the border.

    Args:
        planes: (S, 3, R, R, C), the last two axes before C indexed by the coordinates of `PLANES`.
        x: (S, K, 3) in [-1, 1].

    Shapes: -> (S, K, 3 C).

    >>> sample_triplane(torch.ones(2, 3, 4, 4, 5), torch.rand(2, 7, 3)).shape
    torch.Size([2, 7, 15])
    """
    s, _, r, _, c = planes.shape
    t = (x.clamp(-1, 1) + 1) * ((r - 1) / 2)  # (S, K, 3)
    low = t.detach().floor().clamp_max(r - 2)
    fraction = (t - low)[..., PLANES]  # (S, K, 3, 2)
    cell = low.long()[..., PLANES]
    plane = torch.arange(3 * s, device=x.device).view(s, 1, 3)
    row = (plane * r + cell[..., 0]) * r + cell[..., 1]  # (S, K, 3)
    row = row[..., None] + torch.tensor([0, 1, r, r + 1], device=x.device)  # (S, K, 3, 4)
    f, g = fraction.unbind(-1)
    weight = torch.stack(((1 - f) * (1 - g), (1 - f) * g, f * (1 - g), f * g), -1)
    table = planes.reshape(-1, c).to(x.dtype)
    return weighted_rows(table, row.view(-1, 4), weight.view(-1, 4)).view(*x.shape[:2], 3 * c)


class TriplaneHypernetwork(nn.Module):
    """Linear map from an embedding to three planes: (S, C) -> (S, 3, R, R, channels)."""

    def __init__(self, embedding: int, resolution: int, channels: int) -> None:
        super().__init__()
        self.shape = (3, resolution, resolution, channels)
        self.linear = nn.Linear(embedding, 3 * resolution**2 * channels)

    def forward(self, z: Tensor) -> Tensor:
        return self.linear(z).unflatten(-1, self.shape)

    def extra_repr(self) -> str:
        _, r, _, c = self.shape
        return f"{self.linear.in_features} -> 3x{c}x{r}x{r}"
