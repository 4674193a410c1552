"""Six prepared spheres to train on."""

import pytest
import torch
from references import fibonacci_sphere
from scipy.spatial import ConvexHull
from torch import Tensor

from riemlayer.data.closed_form import Sphere
from riemlayer.data.sample_file import write_sample


def sphere_sample(seed: int, sources: int = 6, vectors: int = 32) -> dict[str, Tensor]:
    """A prepared sample of a sphere with exact ground truth; pairs as in the real ones."""
    generator = torch.Generator().manual_seed(seed)
    vertices = fibonacci_sphere(600)
    faces = torch.from_numpy(ConvexHull(vertices.numpy()).simplices)
    p = vertices[torch.randperm(600, generator=generator)[:sources], None]
    v = torch.randn(sources, vectors, 3, generator=generator, dtype=torch.float64)
    v[:, vectors // 2 :] = v[:, : vectors // 2] + 0.1 * v[:, vectors // 2 :]
    v = Sphere().project_to_tangent(p, v)
    v = 0.5 * v / v.norm(dim=-1, keepdim=True).clamp_min(1)
    sample = {"vertices": vertices, "p": p[:, 0], "normal": p[:, 0], "v": v}
    sample = {k: x.float() for k, x in (sample | {"q": Sphere().exp(p, v)}).items()}
    flags = torch.ones(sources, vectors, dtype=torch.bool)
    return sample | {"faces": faces.int(), "complete": flags, "divergence": 0.1 * flags}


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """Six prepared shapes, of which the hash of the name holds one back."""
    folder = tmp_path_factory.mktemp("samples")
    for i in range(6):
        sample = {name: x.numpy() for name, x in sphere_sample(i).items()}
        metadata = {"name": f"sphere{i}", "source": f"spheres/{i}"}
        write_sample(folder / f"sphere{i}.safetensors", sample, metadata)
    return folder


@pytest.fixture
def full_precision(monkeypatch):
    """No bfloat16 products, also on a processor that has them."""
    monkeypatch.setattr("riemlayer.field._has_bfloat16", lambda device: False)
