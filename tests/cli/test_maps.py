"""`log`, `exp` and `geodesic` answer what the Python API answers, in the file's units and order."""

import numpy as np
import pytest
import torch

from riemlayer.viz import checkerboard

CLOSE = {"rtol": 1e-4, "atol": 2e-6}


def asked(surface, p, q):
    return surface.log(*(torch.from_numpy(x).float() for x in (p, q)), return_info=True)


@pytest.mark.parametrize("name", ["cloud.npz", "cloud.xyz"])
def test_log_is_the_api_s(well, shapes, tiny, tmp_path, points, surface, name, arrays):
    out = tmp_path / "log.npz"
    facts = well("log", shapes / name, "-s", 7, "-o", out, "--weights", tiny, "--json").facts
    written = arrays(out)
    v, info = asked(surface, points[7], points)
    frame = surface.frame(torch.from_numpy(points[7]).float())
    assert np.array_equal(written["points"], points)
    np.testing.assert_allclose(written["log"], v, **CLOSE)
    np.testing.assert_allclose(written["validity"], info.validity, **CLOSE)
    np.testing.assert_allclose(written["frame"], frame, **CLOSE)
    np.testing.assert_allclose(written["uv"], v @ frame[:, :2], **CLOSE)
    p, q = torch.from_numpy(points[7]).float(), torch.from_numpy(points).float()
    np.testing.assert_allclose(written["distance"], surface.dist(p, q), **CLOSE)
    assert np.array_equal(written["valid"], surface.valid_mask(p, q))
    assert np.array_equal(written["source"], points[7])
    assert written["radius"] == pytest.approx(float(surface.radius), rel=1e-6)
    assert facts["source"] == {"index": 7, "point": points[7].tolist(), "snapped_by": 0.0}
    assert facts["points"] == len(points) and facts["out"] == str(out)


def test_exp_is_the_api_s_for_ambient_and_for_plane_vectors(
    well, shapes, tiny, tmp_path, points, surface, arrays
):
    rng = np.random.default_rng(0)
    v = 0.3 * rng.normal(size=(9, 3))
    np.save(tmp_path / "v.npy", v)
    frame = surface.frame(torch.from_numpy(points[7]).float()).double().numpy()
    np.save(tmp_path / "x.npy", (v @ frame[:, :2]).astype(np.float32))
    for name, given in (("v", v), ("x", v @ frame[:, :2] @ frame[:, :2].T)):
        out = tmp_path / f"{name}.npz"
        words = ["exp", shapes / "cloud.npz", "--source", 7, "--vectors", tmp_path / f"{name}.npy"]
        well(*words, "-o", out, "--weights", tiny)
        written = arrays(out)
        p, x = (torch.from_numpy(y).float() for y in (points[7], given))
        q, info = surface.exp(p, x, return_info=True)
        np.testing.assert_allclose(written["vectors"], given, **CLOSE)
        np.testing.assert_allclose(written["points"], q, **CLOSE)
        np.testing.assert_allclose(written["validity"], info.validity, **CLOSE)


def test_exp_without_vectors_shoots_a_fan_of_up_to_the_trained_radius(
    well, shapes, tiny, tmp_path, arrays
):
    out = tmp_path / "fan.npz"
    facts = well("exp", shapes / "ball.ply", "-s", 0, "-o", out, "--weights", tiny, "--json").facts
    written = arrays(out)
    length = np.linalg.norm(written["vectors"], axis=1)
    assert len(length) == facts["vectors"] > 100 and facts["beyond_radius"] == 0
    assert length.max() == pytest.approx(float(written["radius"]))
    assert np.abs(written["vectors"] @ written["frame"][:, 2]).max() < 1e-5
    assert np.abs(written["vectors"].mean(0)).max() < 1e-6


def test_geodesics_are_the_api_s(well, shapes, tiny, tmp_path, points, surface, arrays):
    out = tmp_path / "path.npz"
    at = ",".join(map(str, points[90] + 1e-9))
    words = ["geodesic", shapes / "cloud.npz", "-s", 7, "--target", 50, "--to", at]
    facts = well(*words, "--samples", 5, "-o", out, "--weights", tiny, "--json").facts
    written = arrays(out)
    p, q = (torch.from_numpy(x).float() for x in (points[7], points[[50, 90]]))
    wanted = surface.geodesic(p, q[:, None], torch.linspace(0, 1, 5))
    np.testing.assert_allclose(written["paths"], wanted, **CLOSE)
    np.testing.assert_allclose(written["length"], surface.dist(p, q), **CLOSE)
    assert np.array_equal(written["valid"], surface.valid_mask(p, q))
    assert [x["index"] for x in facts["targets"]] == [50, None]
    assert facts["targets"][1]["snapped_by"] == pytest.approx(1e-9 * 3**0.5, rel=1e-3)


def test_coordinates_are_snapped_to_the_surface_of_a_mesh(
    well, shapes, tiny, tmp_path, ball, arrays
):
    a, b, c = ball.vertices[ball.faces[11]]
    inside = 0.5 * a + 0.3 * b + 0.2 * c
    normal = np.cross(b - a, c - a)
    off = inside + 0.1 * normal / np.linalg.norm(normal)
    at = ",".join(f"{x:.17g}" for x in off)
    out = tmp_path / "log.npz"
    words = ["log", shapes / "ball.ply", "--at", at, "-o", out, "--weights", tiny, "--json"]
    facts = well(*words).facts
    assert facts["source"]["index"] is None
    assert facts["source"]["snapped_by"] == pytest.approx(0.1)
    np.testing.assert_allclose(arrays(out)["source"], inside, rtol=1e-12)
    assert np.array_equal(arrays(out)["points"], ball.vertices)


@pytest.mark.parametrize(("unit", "shift"), [(1e-3, 0), (1e3, 0), (1e9, 0), (1.0, 2.0**25)])
def test_the_unit_and_the_place_change_nothing_else(
    well, shapes, tiny, tmp_path, points, unit, shift, arrays
):
    """Millimetres, kilometres, 1e9-sized coordinates."""
    moved = points.astype(np.float32).astype(float) * unit + shift
    np.savez(tmp_path / "moved.npz", points=moved)
    files = {"here": shapes / "cloud.npz", "there": tmp_path / "moved.npz"}
    here, there = {}, {}
    for (name, file), answer in zip(files.items(), (here, there), strict=True):
        for command in ("log", "exp"):
            out = tmp_path / f"{name}-{command}.npz"
            well(command, file, "--source", 3, "-o", out, "--weights", tiny)
            answer[command] = arrays(out)
    close = {"rtol": 1e-5, "atol": 1e-6 * unit}
    for name in ("log", "uv", "distance"):
        np.testing.assert_allclose(there["log"][name], unit * here["log"][name], **close)
    np.testing.assert_allclose(there["log"]["validity"], here["log"]["validity"], atol=1e-5)
    ends = there["exp"]["points"] - shift
    np.testing.assert_allclose(ends, unit * here["exp"]["points"], **close)


def test_a_mesh_keeps_its_vertices_and_faces(well, shapes, tiny, tmp_path, ball, arrays):
    import trimesh

    words = ["log", shapes / "ball.obj", "--source", 4, "--weights", tiny, "--points", 300]
    for suffix in (".ply", ".obj", ".npz"):
        well(*words, "-o", tmp_path / f"log{suffix}")
    log = arrays(tmp_path / "log.npz")
    texture = 0.5 + log["uv"] / (2 * log["radius"])
    ply = trimesh.load(tmp_path / "log.ply", process=False)
    obj = trimesh.load(tmp_path / "log.obj", process=False)
    for mesh in (ply, obj):
        np.testing.assert_allclose(mesh.vertices, log["points"], rtol=1e-7)
        assert np.array_equal(mesh.faces, ball.faces)
        np.testing.assert_allclose(mesh.visual.uv, texture, atol=1e-5)
    reached = log["valid"] & (log["distance"] <= log["radius"])
    uv = np.where(reached[:, None], log["uv"], 1e9)
    colours = checkerboard(uv, log["radius"] / 5, log["radius"])
    raw = ply.metadata["_ply_raw"]["vertex"]["data"]
    shades = np.stack([raw[name] for name in ("red", "green", "blue")], 1)
    np.testing.assert_allclose(shades / 255, colours, atol=1 / 255)
    np.testing.assert_allclose(raw["distance"], log["distance"], rtol=1e-6)
    np.testing.assert_allclose(raw["validity"], log["validity"], rtol=1e-6)


@pytest.mark.parametrize(
    ("command", "more"),
    [
        ("log", ["--source", 3]),
        ("exp", ["--source", 3]),
        ("geodesic", ["--source", 3, "--target", 9]),
        ("stitch", ["--source", 3, "--depth", 1]),
        ("decal", ["--source", 3]),
        ("mean", ["-p", 3, "-p", 9]),
    ],
)
@pytest.mark.parametrize("suffix", [".npz", ".ply", ".obj", ".html", ".png"])
def test_every_answer_in_every_form(well, shapes, tiny, tmp_path, arrays, command, more, suffix):
    if suffix == ".png":
        if command not in ("exp", "decal"):
            pytest.skip("pages are made of the same drawings, and pictures take a second each")
        pytest.importorskip("pyvista")
    out = tmp_path / f"out{suffix}"
    name = "ball.ply" if suffix == ".ply" else "cloud.npz"
    before = (shapes / name).read_bytes()
    done = well(command, shapes / name, *more, "-o", out, "--weights", tiny, "--points", 300)
    assert str(out) in done.stdout and done.stderr == ""
    assert [x.name for x in tmp_path.iterdir()] == [out.name]
    assert (shapes / name).read_bytes() == before
    head = {".npz": b"pk", ".ply": b"ply", ".obj": b"# riem", ".html": b"<!doc", ".png": b"\x89png"}
    assert out.read_bytes().lower().startswith(head[suffix])
    if suffix == ".npz":
        assert all(np.isfinite(x).all() for x in arrays(out).values())
