"""Fans of all scales at a source as one, whose points count as learned (ours)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from riemlayer.geometry import WALKED, Fan
from riemlayer.heads.branch import TRAINED
from riemlayer.numerics import safe_norm

NEAR, MIDDLE, BEYOND = 0.2, 0.3, 1.3
"""Chords, in radii, up to which fans have no share in Log, from which they have a full one, and
beyond which none again: no geodesic is shorter than its chord."""


class JointFan(nn.Module):
    """Lets the fans that were walked over planes of every scale answer as one.

    A query reads the log map around the points near it, at whichever scale they were walked, by one
    softmax. Logs of the scales mix where they agree; where they do not, at a cut locus or beyond an
    edge that one of them missed, one prevails, with one seam. What a point counts beside its
    distance is learned from what its walk met, how long it was, and what the planes say at the
    source. Untrained, all points count alike.

    Args:
        fans: number of fans at each source.
        site: channels of what the planes say there.

    Shapes: fans (S fans, F, ...), those of a source in turn, site (S, ...) -> (S, fans F, ...)
    """

    def __init__(self, fans: int, site: int, hidden: int = 16) -> None:
        super().__init__()
        self.fans = fans
        self.at_source = nn.Linear(site, fans * hidden)
        self.at_point = nn.Linear(WALKED, hidden, bias=False)
        self.count = nn.Linear(hidden, 1)
        nn.init.zeros_(self.count.weight)
        nn.init.zeros_(self.count.bias)

    def forward(self, fan: Fan, site: Tensor) -> Fan:
        with torch.autocast(site.device.type, enabled=False):
            at_source = self.at_source(site).view(len(fan.values), 1, -1)
            count = self.count(F.gelu(at_source + self.at_point(fan.walked)))
        return fan.counting(count).joined(self.fans)


def fan_share(x: Tensor) -> Tensor:
    """Share (..., 1) that fans have in Log at chords (..., 3) in radii, without a kink."""
    length = safe_norm(x)
    near = ((length - NEAR) / (MIDDLE - NEAR)).clamp(0, 1)
    far = ((BEYOND - length) / (BEYOND - TRAINED)).clamp(0, 1)
    return near.square() * (3 - 2 * near) * far.square() * (3 - 2 * far)
