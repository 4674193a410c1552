"""SIREN in the place of triplane and GELU: the ablation of Tab. 5."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import torch
from torch import Tensor, nn

from riemlayer.config import LAYERS, HeadConfig

W0 = 30.0
"""Frequency of the sines (Sitzmann et al. 2020)."""


class SirenDecoder(nn.Module):
    """Sine network modulated by the embedding (Tab. 5): the paper's "OCNN + SIREN".

    h_{l+1} = sin(w0 (1 + gamma_l) (W_l h_l + b_l) + beta_l), where h_0 is the query beside what
    else the decoder is told. The paper does not say how z modulates it. Here one linear map of z
    gives gamma_l and beta_l of every layer: FiLM, as in pi-GAN, where an MLP of a random code gives
    them. Weights start as in Sitzmann et al. 2020, the last ones small where the maps are anchored.
    All in full precision: w0 would turn the rounding of bfloat16 into phases.

    Args:
        embedding: C, channels of z.
        inputs: channels of the query and of what else the decoder is told.
        config: width.
        layers: number of linear layers.

    Shapes: z (S, C), x (S, K, 3), told (S, K, ...), site (S, ...) -> (S, K, 3), and what
    `read` makes of the hidden features, (..., width) -> (...), as (S, K).

    >>> decoder = SirenDecoder(16, inputs=5, config=HeadConfig(decoder="siren"))
    >>> z, x, told, site = torch.rand(2, 16), torch.rand(2, 7, 3), (), torch.rand(2, 2)
    >>> [y.shape for y in decoder(z, x, told, site, lambda hidden: hidden.sum(-1))]
    [torch.Size([2, 7, 3]), torch.Size([2, 7])]
    """

    def __init__(
        self, embedding: int, inputs: int, config: HeadConfig, layers: int = LAYERS
    ) -> None:
        super().__init__()
        widths = [inputs, *[config.hidden] * (layers - 1)]
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))
        self.film = nn.Linear(embedding, 2 * (layers - 1) * config.hidden)
        self.out = nn.Linear(config.hidden, 3)
        bound = math.sqrt(6 / config.hidden) / W0
        for i, layer in enumerate([*self.layers, self.out]):
            first = 1 / inputs if i == 0 else bound
            nn.init.uniform_(layer.weight, -first, first)  # pyright: ignore[reportArgumentType]
        if config.anchored:
            nn.init.normal_(self.out.weight, std=0.01)

    def forward(
        self,
        z: Tensor,
        x: Tensor,
        told: tuple[Tensor, ...],
        site: Tensor,
        read: Callable[[Tensor], Tensor],
    ) -> tuple[Tensor, Tensor]:
        with torch.autocast(x.device.type, enabled=False):
            film = self.film(z.to(x.dtype)).unflatten(-1, (2, len(self.layers), 1, -1))
            scales, shifts = film.movedim(0, 2).unbind()  # (layers, S, 1, width)
            hidden = torch.cat((x, *told, site[:, None].expand(*x.shape[:2], -1)), -1)
            for layer, scale, shift in zip(self.layers, scales, shifts, strict=True):
                hidden = torch.sin(W0 * (1 + scale) * layer(hidden) + shift)  # (S, K, width)
            answer = self.out(hidden)
        return answer, read(hidden).to(x.dtype)
