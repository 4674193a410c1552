"""Under autocast networks may take halves; coordinates, frames and turns keep their precision."""

import pytest
import torch
from references import fibonacci_sphere

from riemlayer import EncodedSurface, ExpLogField
from riemlayer.losses import isometric_loss
from riemlayer.ops import decal, frechet_mean, local_geometry, stitch_log

NETWORKS = 0.02
"""What halves in a network change of a map, in radii, at most."""


@pytest.fixture(scope="module")
def surface() -> EncodedSurface:
    with torch.inference_mode():
        return ExpLogField.from_pretrained("base").encode(fibonacci_sphere(800).float())


def up(surface: EncodedSurface) -> torch.Tensor:
    return surface.frame(surface.points[3])[:, 1]


EXACT = {
    "transport along edges": lambda s: local_geometry(s, k=6).transport,
    "coordinates": lambda s: s.from_2d(s.points, s.to_2d(s.points, s.points.roll(1, -1))),
    "frames": lambda s: s.frame(s.points),
    "Eq. (3)": lambda s: isometric_loss(s.frame(s.points)[..., :2] * 1.001),
}
NEAR = {
    "log edges": lambda s: local_geometry(s, k=6).log,
    "mean": lambda s: frechet_mean(s, s.points[:3] * 0.05 + s.points[3] * 0.95),
    "transport": lambda s: s.transport(s.points[3], s.points[11], up(s)),
    "stitched chart": lambda s: stitch_log(s, s.points[3], s.points[:40], depth=2).coordinates,
    "decal": lambda s: decal(s, s.points[3], up(s), 0.5, s.points[:20]).uv,
}


@pytest.mark.parametrize("what", [*EXACT, *NEAR])
@torch.inference_mode()
def test_autocast_leaves_geometry_in_its_precision(surface, what):
    ask, atol = (EXACT[what], 1e-5) if what in EXACT else (NEAR[what], NETWORKS)
    expected = ask(surface)
    with torch.autocast("cpu", torch.bfloat16):
        answer = ask(surface)
    assert answer.dtype == torch.float32
    torch.testing.assert_close(answer, expected, atol=atol, rtol=0, equal_nan=True)
