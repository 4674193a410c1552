"""Files of every kind become one cloud in the cube; bad ones are named."""

import numpy as np
import pytest

from riemlayer.data.load import load_shape

pytest.importorskip("trimesh")
import trimesh


@pytest.fixture(scope="module")
def sphere() -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=5.0)
    mesh.apply_translation([100, 0, 0])
    return mesh


@pytest.fixture
def cloud() -> np.ndarray:
    x = np.random.default_rng(0).normal(size=(50, 3))
    return 7 + 3 * x / np.linalg.norm(x, axis=1, keepdims=True)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["obj", "off", "ply", "stl", "glb"])
def test_mesh_files_give_samples_of_the_surface_in_the_cube(sphere, tmp_path, suffix):
    path = tmp_path / f"mesh.{suffix}"
    sphere.export(path)
    shape = load_shape(path, count=500)
    assert shape.points.shape == (500, 3) and shape.points.dtype == np.float32
    assert np.abs(np.linalg.norm(shape.points, axis=1) - 1).max() < 0.02
    assert shape.vertices is not None and np.abs(shape.vertices).max() == pytest.approx(1)


@pytest.mark.parametrize("name", ["cloud.xyz", "cloud.txt", "cloud.npz", "cloud.ply"])
def test_clouds_keep_their_points_and_have_no_faces(cloud, tmp_path, name):
    path = tmp_path / name
    if name.endswith("npz"):
        np.savez(path, points=cloud)
    elif name.endswith("ply"):
        trimesh.PointCloud(cloud).export(path)
    else:
        np.savetxt(path, np.hstack([cloud, cloud]), header="x y z and a colour")
    shape = load_shape(path)
    assert shape.faces is None and shape.points.shape == cloud.shape
    assert np.abs(shape.points).max() == pytest.approx(1)
    ratio = np.linalg.norm(np.diff(cloud, axis=0), axis=1)
    ratio /= np.linalg.norm(np.diff(shape.points, axis=0), axis=1)
    assert np.allclose(ratio, ratio[0], rtol=1e-4)


@pytest.mark.parametrize("names", [("vertices", "faces"), ("V", "F")])
def test_points_and_mesh_of_one_file_stay_in_one_frame(sphere, tmp_path, names):
    path = tmp_path / "both.npz"
    mesh = dict(zip(names, (sphere.vertices, sphere.faces), strict=True))
    np.savez(path, points=sphere.vertices[::3], **mesh)
    shape = load_shape(path)
    assert shape.vertices is not None
    assert np.allclose(shape.points, shape.vertices[::3], atol=1e-6)
    assert np.array_equal(shape.faces, sphere.faces)


def test_the_cube_leads_back_to_the_file(cloud, tmp_path):
    np.savetxt(tmp_path / "a.xyz", cloud)
    shape = load_shape(tmp_path / "a.xyz")
    assert np.allclose(shape.centre + shape.scale * shape.points, cloud, atol=1e-5)


@pytest.mark.parametrize("scale", [1e-3, 1e3, 1e9])
def test_the_unit_of_a_cloud_does_not_matter(cloud, tmp_path, scale):
    for name, points in (("one.xyz", cloud), ("other.xyz", scale * cloud)):
        np.savetxt(tmp_path / name, points, fmt="%.17g")
    one, other = (load_shape(tmp_path / name) for name in ("one.xyz", "other.xyz"))
    assert np.abs(one.points - other.points).max() < 1e-6
    assert other.scale == pytest.approx(scale * one.scale)


def test_a_mesh_far_from_the_origin_keeps_its_detail(tmp_path):
    """1e9 away, float64 still tells a tenth of a millimetre; float32 would not tell 60 metres."""
    v, f = trimesh.creation.box().vertices.copy(), trimesh.creation.box().faces
    far = v + np.array([1e9, -1e9, 1e9])
    points = np.concatenate([far, far.mean(0, keepdims=True)])
    np.savez(tmp_path / "far.npz", vertices=far, faces=f, points=points)
    shape = load_shape(tmp_path / "far.npz")
    assert np.allclose(np.abs(shape.points[:8]), 1, atol=1e-6)
