"""Hyper-modulated triplanes (Sec. 3.2): an embedding makes three planes, queries sample them."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from riemlayer.config import LAYERS, HeadConfig
from riemlayer.numerics import weighted_rows

PLANES = ((0, 1), (0, 2), (1, 2))
"""Coordinates of the planes xy, xz, yz."""
FEW = 16
"""Sources for which casting the hypernetwork's weights would take longer than the product."""
ROWS = 3072
"""Queries whose hidden features are made at once where no gradient is asked for and nothing is
traced: what they take stays in a core's cache."""


def sample_triplane(planes: Tensor, x: Tensor, resolution: int | None = None) -> Tensor:
    """Bilinear features of queries on three planes (Sec. 3.2, step 2).

    Corners are aligned: -1 and 1 are the outermost samples. A query outside [-1, 1] takes the value
    at the border. Derivatives are gather-based, because `F.grid_sample`, four times faster, has
    neither a forward mode nor a second derivative.

    Args:
        planes: (S, 3, R, R, C), the last two axes before C indexed by the coordinates of `PLANES`.
        x: (S, K, 3) in [-1, 1].
        resolution: of the whole planes, where `planes` are the middle of them.

    Shapes: -> (S, K, 3 C).

    >>> sample_triplane(torch.ones(2, 3, 4, 4, 5), torch.rand(2, 7, 3)).shape
    torch.Size([2, 7, 15])
    """
    s, _, r, _, c = planes.shape
    if resolution is not None and resolution > r:
        x = x * ((resolution - 1) / (r - 1))
    if not torch.is_grad_enabled():
        with suppress(NotImplementedError):  # forward mode, which goes on below
            return _sample_fused(planes, x)
    t = (x.movedim(-1, 0).clamp(-1, 1) + 1) * ((r - 1) / 2)  # (3, S, K): columns are faster
    low = t.detach().int().clamp_max(r - 2)
    plane = torch.arange(3 * s, dtype=torch.int32, device=x.device).view(s, 3, 1).movedim(0, 1)
    i, j = _on_planes(low)
    row = (plane * r + i) * r + j  # (3, S, K)
    f, g = _on_planes(t - low)
    rows = torch.stack((row, row + 1, row + r, row + r + 1))  # (4, 3, S, K)
    weight = torch.stack(((1 - f) * (1 - g), (1 - f) * g, f * (1 - g), f * g))
    rows, weight = (y.permute(2, 3, 1, 0).reshape(-1, 4) for y in (rows, weight))
    table = planes.reshape(-1, c).to(x.dtype)
    return weighted_rows(table, rows, weight).view(*x.shape[:2], 3 * c)


def _sample_fused(planes: Tensor, x: Tensor) -> Tensor:
    s, _, _, _, c = planes.shape
    grid = torch.stack([x[..., [j, i]] for i, j in PLANES], 1).flatten(0, 1)[:, None]
    table = planes.to(x.dtype).flatten(0, 1).permute(0, 3, 1, 2)  # (3 S, C, R, R)
    features = F.grid_sample(table, grid, padding_mode="border", align_corners=True)
    return features.view(s, 3 * c, -1).mT


def _on_planes(y: Tensor) -> tuple[Tensor, Tensor]:
    """First and second coordinate (3, ...) on each plane, of coordinates (3, ...) in space."""
    return torch.stack([y[i] for i, _ in PLANES]), torch.stack([y[j] for _, j in PLANES])


class TriplaneHypernetwork(nn.Module):
    """Linear map from an embedding to three planes: (S, C) -> (S, 3, R, R, channels).

    For queries (S, K, 3) close to their sources, such as edges of a graph, only the middle of the
    planes is made: as many samples as they need.
    """

    def __init__(self, embedding: int, resolution: int, channels: int) -> None:
        super().__init__()
        self.shape = (3, resolution, resolution, channels)
        self.linear = nn.Linear(embedding, 3 * resolution**2 * channels)

    def forward(self, z: Tensor, x: Tensor | None = None) -> Tensor:
        weight, bias, shape = self.linear.weight, self.linear.bias, self.shape
        beyond = 0 if x is None else self._not_needed(x)
        if beyond:
            middle = slice(beyond, -beyond)
            weight, bias = (y.unflatten(0, shape)[:, middle, middle] for y in (weight, bias))
            shape = bias.shape
            weight, bias = weight.flatten(0, 3), bias.flatten()
        half = torch.is_autocast_enabled(z.device.type) and len(z) > FEW
        with torch.autocast(z.device.type, enabled=half):
            return F.linear(z, weight, bias).unflatten(-1, shape)

    def _not_needed(self, x: Tensor) -> int:
        """How many samples at each border of the planes no query (S, K, 3) in [-1, 1] needs."""
        if torch.compiler.is_compiling():
            return 0  # sizes must not depend on data
        r = self.shape[1]
        furthest = float(x.detach().abs().amax()) * (r - 1) if x.numel() else 0.0
        return max(0, min(r // 2 - 1, math.floor((r - 1 - furthest) / 2 - 1e-4)))

    def extra_repr(self) -> str:
        _, r, _, c = self.shape
        return f"{self.linear.in_features} -> 3x{c}x{r}x{r}"


class TriplaneDecoder(nn.Module):
    """Tiny MLP on the triplane's features at a query (Sec. 3.2, steps 2 and 3).

    What it is told of a source is the same for all queries there: its part of the first layer is
    computed once a source.

    Args:
        inputs: channels of the query and of what else the decoder is told.
        config: planes and width.
        layers: number of linear layers.

    Shapes: planes (S, 3, R, R, C), x (S, K, 3), told (S, K, ...), site (S, ...) -> (S, K, 3), and
    what `read` makes of the hidden features, (N, width) -> (N,), as (S, K).
    """

    def __init__(self, inputs: int, config: HeadConfig, layers: int = LAYERS) -> None:
        super().__init__()
        self.resolution = config.resolution
        widths = [3 * config.channels + inputs, *[config.hidden] * (layers - 1)]
        body = []
        for a, b in pairwise(widths):
            body += [nn.Linear(a, b), nn.GELU()]
        self.body = nn.Sequential(*body)
        self.out = nn.Linear(config.hidden, 3)
        if config.anchored:
            nn.init.normal_(self.out.weight, std=0.01)

    def forward(
        self,
        planes: Tensor,
        x: Tensor,
        told: tuple[Tensor, ...],
        site: Tensor,
        read: Callable[[Tensor], Tensor],
    ) -> tuple[Tensor, Tensor]:
        features = sample_triplane(planes, x, self.resolution)
        inputs = (y.contiguous() for y in (features.to(x.dtype), x, *told))  # else cat is slow
        rows = torch.cat([*inputs], -1).flatten(0, 1)
        source = torch.arange(x.shape[0], device=x.device)[:, None].expand(x.shape[:2]).flatten()
        first, *rest = self.body
        whole = torch.is_grad_enabled() or torch.compiler.is_compiling()
        parts = (
            [(rows, source)] if whole else zip(rows.split(ROWS), source.split(ROWS), strict=True)
        )
        answers, readings = [], []
        for part in parts:
            hidden = linear_with_site(first, site, *part)  # pyright: ignore[reportArgumentType]
            for layer in rest:
                hidden = layer(hidden)
            answers.append(self.out(hidden).to(x.dtype))
            readings.append(read(hidden).to(x.dtype))
        return torch.cat(answers).view(x.shape), torch.cat(readings).view(x.shape[:2])


def linear_with_site(layer: nn.Linear, site: Tensor, rows: Tensor, source: Tensor) -> Tensor:
    """layer(rows || site[source]): (N, a), (S, b), (N,) -> (N, c), with one product a source.

    >>> layer, rows, site = nn.Linear(5, 4), torch.rand(6, 3), torch.rand(2, 2)
    >>> source = torch.tensor([0, 0, 0, 1, 1, 1])
    >>> both = layer(torch.cat((rows, site[source]), -1))
    >>> bool(torch.isclose(linear_with_site(layer, site, rows, source), both, atol=1e-6).all())
    True
    """
    own, shared = layer.weight.split((rows.shape[-1], site.shape[-1]), 1)
    at_site = F.linear(site, shared, layer.bias)
    if not torch.compiler.is_compiling() and len(site) == 1:
        return F.linear(rows, own, at_site[0])
    return F.linear(rows, own) + at_site.index_select(0, source)
