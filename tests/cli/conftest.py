"""A tiny field, small shapes, and a way to call the program in this process."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from references import lumpy, shaken
from typer.testing import CliRunner

from riemlayer import EncodedSurface, ExpLogField
from riemlayer.cli.app import app


class Ran(NamedTuple):
    """What a call did."""

    code: int
    stdout: str
    stderr: str

    @property
    def facts(self) -> dict[str, Any]:
        """The one JSON object on stdout."""
        (line,) = self.stdout.splitlines()
        return json.loads(line)


@pytest.fixture
def arrays():
    return read_arrays


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """The content of an .npz."""
    with np.load(path) as file:
        return {name: file[name] for name in file}


@pytest.fixture
def run():
    """Calls `riemlayer` with these words."""

    def call(*words: object) -> Ran:
        done = CliRunner().invoke(app, [str(word) for word in words])
        return Ran(done.exit_code, done.stdout, done.stderr)

    return call


@pytest.fixture
def well(run):
    """Calls `riemlayer` and demands that it goes well."""

    def call(*words: object) -> Ran:
        done = run(*words)
        assert done.code == 0, done.stderr
        return done

    return call


@pytest.fixture
def refused():
    """Demands that a call ended with 2, and a last line that has these words."""

    def check(done: Ran, *words: str) -> None:
        line = done.stderr.splitlines()[-1]
        assert done.code == 2 and line.startswith("riemlayer "), (done.code, done.stderr)
        assert all(word in line for word in words), line

    return check


@pytest.fixture(scope="session")
def tiny(tmp_path_factory) -> Path:
    """Folder of a field with random weights."""
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("weights") / "tiny"
    shaken("tiny", torch.float32, strength=0.3).save_pretrained(folder)
    return folder


@pytest.fixture(scope="session")
def points() -> np.ndarray:
    """A cloud that fills the cube in its longest direction, so that no scaling takes part."""
    x = lumpy(600).numpy()
    low, high = x.min(0), x.max(0)
    return ((x - (low + high) / 2) / ((high - low).max() / 2)).astype(np.float32).astype(float)


@pytest.fixture(scope="session")
def shapes(tmp_path_factory, points) -> Path:
    """Folder with cloud.npz, cloud.xyz and a mesh in ball.ply and ball.obj."""
    trimesh = pytest.importorskip("trimesh")
    folder = tmp_path_factory.mktemp("shapes")
    np.savez(folder / "cloud.npz", points=points)
    np.savetxt(folder / "cloud.xyz", points, fmt="%.17g")
    ball = trimesh.creation.icosphere(subdivisions=3, radius=5.0)
    ball.apply_translation([100, 0, 0])
    for suffix in ("ply", "obj"):
        ball.export(folder / f"ball.{suffix}")
    return folder


@pytest.fixture(scope="session")
def ball(shapes):
    """The mesh of ball.ply."""
    import trimesh

    return trimesh.load(shapes / "ball.ply", process=False)


@pytest.fixture(scope="session")
def surface(tiny, points) -> EncodedSurface:
    """The cloud, encoded by the Python API."""
    field = ExpLogField.from_pretrained(tiny).requires_grad_(False)
    return field.encode(torch.from_numpy(points).float())
