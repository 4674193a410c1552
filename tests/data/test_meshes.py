"""Reading, checking, closing and remeshing meshes."""

import re

import numpy as np
import pytest
import trimesh

from riemlayer.data.manifold import manifold_defect, orient, signed_volume
from riemlayer.data.meshes import (
    check_mesh,
    is_watertight_manifold,
    load_mesh,
    merge_by_position,
    normalise,
    prepare_mesh,
    remesh,
    sample_surface,
)
from riemlayer.data.slivers import heights, remove_slivers
from riemlayer.data.watertight import make_watertight, unsigned_distance_grid


def box(centre=(0, 0, 0), side=2.0):
    mesh = trimesh.creation.box((side, side, side))
    return np.array(mesh.vertices) + centre, np.array(mesh.faces)


def together(*meshes):
    """Several meshes as one."""
    start = np.cumsum([0] + [len(v) for v, _ in meshes])
    faces = [f + s for (_, f), s in zip(meshes, start, strict=False)]
    return np.concatenate([v for v, _ in meshes]), np.concatenate(faces)


def sphere(subdivisions=3):
    mesh = trimesh.creation.icosphere(subdivisions)
    return np.array(mesh.vertices), np.array(mesh.faces)


TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


# Connectivity


def test_closed_meshes_are_manifold():
    assert is_watertight_manifold(*box())
    assert is_watertight_manifold(*sphere())


def test_a_hole_is_a_defect_unless_open_meshes_are_allowed():
    vertices, faces = box()
    assert "boundary" in (manifold_defect(vertices, faces[1:]) or "")
    assert manifold_defect(vertices, faces[1:], closed=False) is None


def test_two_components_are_a_defect():
    assert "component" in (manifold_defect(*together(box(), box((5, 0, 0)))) or "")


def test_a_face_wound_against_the_others_is_a_defect():
    vertices, faces = box()
    faces[3] = faces[3, ::-1]
    assert "direction" in (manifold_defect(vertices, faces) or "")
    assert manifold_defect(vertices, orient(vertices, faces)) is None


def test_two_tetrahedra_that_share_a_vertex_are_a_defect():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    two = np.concatenate([vertices, -vertices[1:]])
    mirrored = np.array([0, 4, 5, 6])[TETRAHEDRON][:, ::-1]
    assert manifold_defect(vertices, TETRAHEDRON) is None
    reason = manifold_defect(two, np.concatenate([TETRAHEDRON, mirrored]))
    assert "fan" in (reason or "")


def test_two_boxes_that_share_an_edge_are_a_defect():
    vertices, faces = merge_by_position(*together(box(), box((2, 2, 0))))
    assert len(vertices) == 14
    assert manifold_defect(vertices, faces) is not None


def test_orient_turns_an_inverted_mesh_outward():
    vertices, faces = box()
    assert signed_volume(vertices, faces) == pytest.approx(8)
    assert signed_volume(vertices, orient(vertices, faces[:, ::-1])) == pytest.approx(8)


# Elementary steps


def test_merge_by_position_closes_a_triangle_soup():
    vertices, faces = sphere()
    soup, apart = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    merged, merged_faces = merge_by_position(soup, np.concatenate([apart, apart[:5]]))
    assert len(merged) == len(vertices)
    assert len(merged_faces) == len(faces)
    assert is_watertight_manifold(merged, merged_faces)


def test_normalise_fills_the_cube_and_can_be_undone():
    raw = np.random.default_rng(0).normal(size=(50, 3)) * [1, 5, 2] + 7
    cube, centre, scale = normalise(raw)
    np.testing.assert_allclose([cube.min(0) + cube.max(0), np.zeros(3)][0], 0, atol=1e-12)
    assert np.abs(cube).max() == pytest.approx(1)
    np.testing.assert_allclose(cube * scale + centre, raw)


def test_samples_are_uniform_by_area():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [8, 0, 0], [5, 3, 0.0]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])  # areas 1 : 9
    points = sample_surface(vertices, faces, 20_000, np.random.default_rng(0))
    small = points[:, 0] < 2
    assert small.mean() == pytest.approx(0.1, abs=0.01)
    np.testing.assert_allclose(points[small].mean(0), [1 / 3, 1 / 3, 0], atol=0.02)
    np.testing.assert_allclose(points[~small].mean(0), [6, 1, 0], atol=0.03)
    inside = points[~small] - [5, 0, 0]
    assert inside.min() >= 0
    assert inside.sum(1).max() <= 3 + 1e-12


@pytest.mark.parametrize(
    ("vertices", "faces", "said"),
    [
        (np.zeros((4, 2)), [[0, 1, 2]], r"vertices must have shape \(n, 3\), got \(4, 2\)"),
        (np.eye(3), np.zeros((0, 3), int), r"faces must have shape \(m, 3\) with m > 0"),
        (np.eye(3), [[0, 1, 3]], "faces must index the 3 vertices"),
        (np.eye(3), [[0, 1, -1]], "faces must index the 3 vertices"),
        (np.eye(3), [[0.0, 1, 2]], "faces must hold integers, got float64"),
        (np.eye(3) * np.nan, [[0, 1, 2]], "vertices must be finite, 3 of 3"),
    ],
)
def test_check_mesh_says_what_is_wrong(vertices, faces, said):
    with pytest.raises(ValueError, match=said):
        check_mesh(vertices, np.array(faces))


# Files


@pytest.mark.parametrize("suffix", ["ply", "obj", "off", "stl", "glb"])
def test_load_mesh_reads_the_usual_formats(tmp_path, suffix):
    vertices, faces = sphere(1)
    path = tmp_path / f"sphere.{suffix}"
    trimesh.Trimesh(vertices, faces).export(path)
    read, read_faces = merge_by_position(*load_mesh(path))
    assert is_watertight_manifold(read, read_faces)
    assert signed_volume(read, read_faces) == pytest.approx(signed_volume(vertices, faces), 1e-4)


def test_load_mesh_concatenates_the_parts_of_a_scene_in_place(tmp_path):
    path = tmp_path / "scene.glb"
    scene = trimesh.Scene([trimesh.Trimesh(*box())])
    shift = trimesh.transformations.translation_matrix([5, 0, 0])
    scene.add_geometry(trimesh.Trimesh(*sphere(1)), transform=shift)
    scene.export(path)
    vertices, faces = load_mesh(path)
    assert len(faces) == 12 + 80
    np.testing.assert_allclose(vertices.max(0), [6, 1, 1], atol=1e-6)


def test_load_mesh_names_a_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere\.ply"):
        load_mesh(tmp_path / "nowhere.ply")


BAD_FILES = {
    "points.ply": "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
    "property float z\nend_header\n0 0 0\n",
    "empty.obj": "# nothing\n",
    "nan.off": "OFF\n3 1 0\n0 0 nan\n1 0 0\n0 1 0\n3 0 1 2\n",
    "range.off": "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n",
    "range.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
    "torn.glb": "glTF not really",
    "what.xyzzy": "?",
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_load_mesh_refuses_bad_files(tmp_path, name):
    path = tmp_path / name
    path.write_text(BAD_FILES[name])
    with pytest.raises(ValueError, match=f"{re.escape(name)}|vertices must|faces must"):
        load_mesh(path)


# Remeshing


def test_remeshing_a_cube_keeps_its_creases():
    vertices, faces = remesh(*box(), count=1500)
    assert is_watertight_manifold(vertices, faces)
    assert 1100 < len(vertices) < 2000
    assert signed_volume(vertices, faces) == pytest.approx(8, rel=1e-6)
    np.testing.assert_allclose(np.abs(vertices).max(1), 1, atol=1e-9)


def test_remeshing_is_isotropic():
    raw = trimesh.creation.cylinder(0.5, 2, sections=64)
    vertices, faces = remesh(np.array(raw.vertices), np.array(raw.faces), count=1500)
    length = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, 1)], axis=-1)
    assert length.std() / length.mean() < 0.25
    assert heights(vertices, faces).min() > 0.04 * length.mean()


def test_remove_slivers_takes_needles_and_caps_out():
    vertices, faces = box()
    edge = np.array([0, int(faces[0][faces[0] != 0][0])])
    middle = vertices[edge].mean(0)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    split, split_faces = trimesh.remesh.subdivide(mesh.vertices, mesh.faces)
    near = np.linalg.norm(split - middle, axis=1).argmin()
    beside = split_faces[(split_faces == near).any(1)].ravel()
    beside = beside[beside != near][0]
    split[near] = 0.9999 * split[beside] + 0.0001 * split[near]  # now in the plane of a face
    assert heights(split, split_faces).min() < 1e-3
    clean, clean_faces = remove_slivers(split, split_faces, 0.01)
    assert heights(clean, clean_faces).min() > 0.01 / 4
    assert is_watertight_manifold(clean, clean_faces)
    assert signed_volume(clean, clean_faces) == pytest.approx(
        signed_volume(split, split_faces), abs=1e-2
    )


def test_ends_of_an_edge_of_no_length_that_cannot_collapse_are_parted():
    """Two of a bipyramid's three middle corners coincide; merging them would leave no solid."""
    vertices = np.array([[0.0, 0, 1], [0, 0, -1], [1, 0, 0], [0, 1, 0], [0, 1, 0]])
    faces = np.array([[0, 2, 3], [0, 3, 4], [0, 4, 2], [1, 3, 2], [1, 4, 3], [1, 2, 4]])
    moved, same = remove_slivers(vertices, faces, 0.01)
    assert (same == faces).all() and heights(moved, faces).min() > 1e-3
    assert np.linalg.norm(moved - vertices, axis=1).max() < 0.0101


def test_remove_slivers_leaves_a_good_mesh_alone():
    vertices, faces = sphere()
    clean, clean_faces = remove_slivers(vertices, faces, 0.01)
    np.testing.assert_array_equal(clean, vertices)
    np.testing.assert_array_equal(clean_faces, faces)


# Watertight shells


def test_the_shell_is_at_the_level_from_an_open_sheet():
    sheet = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    shell, faces = make_watertight(sheet, np.array([[0, 1, 2], [0, 2, 3]]), size=64, level=0.05)
    assert is_watertight_manifold(shell, faces)
    assert signed_volume(shell, faces) > 0
    beyond = np.linalg.norm(shell - np.clip(shell, [-1, -1, 0], [1, 1, 0]), axis=1)
    np.testing.assert_allclose(beyond, 0.05 / 0.8, atol=0.006)


def test_the_distance_grid_is_that_of_mesh2sdf():
    mesh2sdf = pytest.importorskip("mesh2sdf")
    vertices, faces = sphere(2)
    vertices, size, level = 0.8 * vertices, 32, 2 / 32
    ours = unsigned_distance_grid(vertices, faces, size, level)
    theirs = np.abs(mesh2sdf.core.compute(vertices, faces, size))
    near = theirs < level + 2 / size
    np.testing.assert_allclose(ours[near], theirs[near], atol=1e-4)
    assert (ours[~near] > level).all()


@pytest.mark.slow
def test_prepare_keeps_samples_of_the_raw_surface_where_a_shell_was_needed():
    vertices, faces = together(box((30, 0, 0)), box((31, 0.3, 0.2)))
    mesh = prepare_mesh(vertices, faces)
    assert is_watertight_manifold(mesh.vertices, mesh.faces)
    assert mesh.soup is not None
    assert mesh.soup.shape == (12_000, 3)
    raw = mesh.soup * mesh.scale + mesh.centre
    on_first = np.isclose(np.abs(raw - [30, 0, 0]).max(1), 1, atol=1e-6)
    on_second = np.isclose(np.abs(raw - [31, 0.3, 0.2]).max(1), 1, atol=1e-6)
    assert (on_first | on_second).all()
    within = np.abs(raw - [31, 0.3, 0.2]).max(1) < 0.9
    assert within.sum() > 500  # sheets inside the other box are kept


def test_prepare_leaves_a_watertight_manifold_where_it_is():
    vertices, faces = box((3, 0, 0), side=4)
    mesh = prepare_mesh(vertices, faces, count=1200)
    assert mesh.soup is None
    assert mesh.scale == pytest.approx(2)
    np.testing.assert_allclose(mesh.centre, [3, 0, 0], atol=1e-9)
    assert signed_volume(mesh.vertices, mesh.faces) == pytest.approx(8, rel=1e-6)


def test_prepare_never_writes_to_its_input():
    vertices, faces = box()
    before = vertices.copy(), faces.copy()
    prepare_mesh(vertices, faces[:, ::-1], count=600)
    np.testing.assert_array_equal(vertices, before[0])
    np.testing.assert_array_equal(faces, before[1])


def test_prepare_says_why_it_fails():
    flat = np.random.default_rng(0).normal(size=(30, 3)) * 0
    with pytest.raises(ValueError, match="vertices must span a volume"):
        prepare_mesh(flat, np.array([[0, 1, 2]]))
