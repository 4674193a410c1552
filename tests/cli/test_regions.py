"""`stitch`, `decal` and `mean` answer what the operators of `riemlayer.ops` answer."""

import numpy as np
import pytest
import torch

from riemlayer import ExpLogField
from riemlayer.cli.decal import seen_from_inside
from riemlayer.cli.loaded import Encoding
from riemlayer.ops import decal, frechet_mean, stitch_log, tangent_pca

CLOSE = {"rtol": 1e-4, "atol": 5e-6}


def single(x):
    return torch.from_numpy(np.ascontiguousarray(x)).float()


def test_stitching_is_the_operator_s(well, shapes, tiny, tmp_path, points, surface, arrays):
    out = tmp_path / "atlas.npz"
    words = ["stitch", shapes / "cloud.npz", "--source", 3, "--depth", 2, "--radius", 0.4]
    facts = well(*words, "-o", out, "--weights", tiny, "--json").facts
    wanted = stitch_log(surface, single(points[3]), single(points), 2, 0.4)
    written = arrays(out)
    assert np.array_equal(written["covered"], wanted.covered)
    np.testing.assert_allclose(written["uv"], wanted.coordinates, **CLOSE)
    np.testing.assert_allclose(written["confidence"], wanted.confidence, **CLOSE)
    np.testing.assert_allclose(written["centres"], wanted.charts.centre, **CLOSE)
    np.testing.assert_allclose(written["offsets"], wanted.charts.offset, **CLOSE)
    assert facts["charts"] == len(wanted.charts.centre) > 1
    assert facts["covered"] == int(wanted.covered.sum())


def test_texture_of_an_atlas_fills_the_square(well, shapes, tiny, tmp_path, arrays):
    words = ["stitch", shapes / "cloud.npz", "--source", 3, "--depth", 1, "--weights", tiny]
    well(*words, "-o", tmp_path / "a.npz")
    well(*words, "-o", tmp_path / "a.obj")
    lines = (tmp_path / "a.obj").read_text().splitlines()
    texture = np.array([x.split()[1:] for x in lines if x.startswith("vt ")], float)
    covered = arrays(tmp_path / "a.npz")["covered"]
    reach = np.linalg.norm(texture[covered] - 0.5, axis=1).max()
    assert reach == pytest.approx(0.5, abs=1e-3) or reach < 0.5
    assert (texture[~covered] == -1).all() and (~covered).any()


def test_a_decal_is_the_operator_s_and_flips(well, shapes, tiny, tmp_path, points, surface, arrays):
    words = ["decal", shapes / "cloud.npz", "--source", 3, "--size", 0.6, "--up", "0,1,0.5"]
    well(*words, "-o", tmp_path / "a.npz", "--weights", tiny)
    well(*words, "-o", tmp_path / "b.npz", "--weights", tiny, "--flip")
    up = torch.tensor([0.0, 1.0, 0.5])
    wanted = decal(surface, single(points[3]), up, 0.6, single(points))
    written, flipped = arrays(tmp_path / "a.npz"), arrays(tmp_path / "b.npz")
    assert np.array_equal(written["inside"], wanted.inside) and wanted.inside.any()
    np.testing.assert_allclose(written["uv"], wanted.uv, **CLOSE)
    np.testing.assert_allclose(flipped["uv"][:, 0], 1 - written["uv"][:, 0], atol=1e-6)
    np.testing.assert_allclose(flipped["uv"][:, 1], written["uv"][:, 1], atol=1e-6)


@pytest.mark.parametrize("turned", [False, True])
def test_a_decal_on_a_mesh_is_seen_from_where_its_faces_look(
    well, tiny, tmp_path, ball, arrays, turned
):
    """From there, u grows to the right of v: (dx/du x dx/dv) points along the faces' normal."""
    mesh = ball.copy()
    if turned:
        mesh.invert()
    mesh.export(tmp_path / "mesh.ply")
    out = tmp_path / "d.npz"
    words = ["decal", tmp_path / "mesh.ply", "--source", 5, "--size", 3, "--points", 500]
    well(*words, "-o", out, "--weights", "base")
    written = arrays(out)
    p, near = written["source"], written["inside"]
    offset = written["points"][near] - p
    slope = np.linalg.lstsq(written["uv"][near] - 0.5, offset, rcond=None)[0]  # (2, 3)
    outward = (p - [100, 0, 0]) * (-1 if turned else 1)
    assert np.cross(slope[0], slope[1]) @ outward > 0


def test_the_colours_of_a_decal_are_the_picture_s(well, shapes, tmp_path):
    image = pytest.importorskip("PIL.Image")
    ExpLogField.from_preset("tiny").save_pretrained(tmp_path / "prior")  # near the prior: it covers
    import trimesh

    picture = np.zeros((10, 10, 3), np.uint8)
    picture[:5], picture[5:] = (255, 0, 0), (0, 0, 255)
    image.fromarray(picture).save(tmp_path / "p.png")
    out = tmp_path / "d.ply"
    words = ["decal", shapes / "cloud.npz", "--source", 3, "--size", 0.6]
    words += ["--weights", tmp_path / "prior"]
    well(*words, "--image", tmp_path / "p.png", "-o", out)
    raw = trimesh.load(out).metadata["_ply_raw"]["vertex"]["data"]
    inside = (raw["s"] >= 0) & (raw["s"] <= 1) & (raw["t"] >= 0) & (raw["t"] <= 1)
    red, blue = inside & (raw["t"] > 0.51), inside & (raw["t"] < 0.49)
    assert red.any() and blue.any()
    assert (raw["red"][red] == 255).all() and (raw["blue"][red] == 0).all()
    assert (raw["blue"][blue] == 255).all() and (raw["red"][blue] == 0).all()


def test_the_mean_is_the_operator_s(well, shapes, tiny, tmp_path, points, surface, arrays):
    near = np.linalg.norm(points - points[3], axis=1).argsort()[:6]
    np.save(tmp_path / "near.npy", near)
    np.save(tmp_path / "masses.npy", np.arange(6) + 1)
    out = tmp_path / "mean.npz"
    words = ["mean", shapes / "cloud.npz", "--among", tmp_path / "near.npy", "-o", out]
    words += ["--masses", tmp_path / "masses.npy", "--weights", tiny]
    facts = well(*words, "--json").facts
    q, w = single(points[near]), torch.arange(1.0, 7)
    mean = frechet_mean(surface, q, w)
    np.testing.assert_allclose(facts["mean"], mean, **CLOSE)
    written = arrays(out)
    np.testing.assert_allclose(written["source"], mean, **CLOSE)
    np.testing.assert_allclose(written["log"], surface.log(mean, single(points)), atol=1e-4)
    principal = tangent_pca(surface, q, w)
    np.testing.assert_allclose(written["variances"], principal.variances, **CLOSE)
    assert np.array_equal(written["averaged"], points[near])


def test_points_by_index_by_coordinates_and_by_file_are_the_same(
    well, shapes, tiny, tmp_path, points
):
    np.save(tmp_path / "x.npy", points[[3, 9]])
    words = ["mean", shapes / "cloud.npz", "--weights", tiny, "--json", "--force"]
    out = ["-o", tmp_path / "m.npz"]
    at = [x for i in (3, 9) for x in ("--at", ",".join(map(str, points[i])))]
    means = [
        well(*words, *out, *named).facts["mean"]
        for named in (["-p", 3, "-p", 9], at, ["--among", tmp_path / "x.npy"])
    ]
    assert means[0] == means[1] == means[2]


def test_a_cloud_does_not_know_its_inside(shapes, tiny):
    loaded = Encoding(shapes / "cloud.npz", str(tiny)).load()
    assert not seen_from_inside(loaded, loaded.points[0], loaded.points[0])
