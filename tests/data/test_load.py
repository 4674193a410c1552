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


@pytest.mark.parametrize(
    "name, content, words",
    [
        ("a.xyz", "", "at least 4 points of 3 numbers"),
        ("a.xyz", "1 2 3\n1 2\n", "three numbers a line"),
        ("a.xyz", "one two three\n", "three numbers a line"),
        ("a.xyz", "1 2 3\n" * 3, r"at least 4 points .* got \(3, 3\)"),
        ("a.xyz", "1 2\n" * 9, r"got \(9, 2\)"),
        ("a.xyz", "1 2 3\n" * 9, "all of them are equal"),
        ("a.xyz", "1 2 3\n4 5 nan\n6 7 8\n9 9 9\n", "1 of 4 are not"),
        ("a.step", "solid", r"end in one of \.obj .* got a\.step"),
        ("a.obj", "v 0 0 0\n", "mesh"),
        ("a.ply", "ply\nthis is no header", "mesh"),
    ],
)
def test_bad_files_are_named(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(ValueError, match=words):
        load_shape(path)


def test_npz_without_a_shape_names_what_it_holds(tmp_path):
    np.savez(tmp_path / "a.npz", weights=np.zeros(3))
    with pytest.raises(ValueError, match=r"must hold `points`.* got \['weights'\]"):
        load_shape(tmp_path / "a.npz")


def test_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"found none at .*nowhere\.obj"):
        load_shape(tmp_path / "nowhere.obj")
