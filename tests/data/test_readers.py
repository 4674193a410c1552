"""What lies in a file comes out, in its own units and order, whatever the format."""

import struct
import tracemalloc

import numpy as np
import pytest

from riemlayer.data import RawShape, read_shape
from riemlayer.data.readers.pcd import expand_lzf

pytest.importorskip("trimesh")
import trimesh

QUADS = """v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 2
"""


@pytest.fixture(scope="module")
def box() -> trimesh.Trimesh:
    mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    mesh.visual.vertex_colors = np.arange(32, dtype=np.uint8).reshape(8, 4) * 8 + 3
    return mesh


def corners(shape: RawShape) -> np.ndarray:
    assert shape.vertices is not None and shape.faces is not None
    return shape.vertices[shape.faces]


# --------------------------------------------------------------------------------------- meshes


@pytest.mark.parametrize(
    "name, how",
    [
        ("a.off", {}),
        ("a.obj", {}),
        ("a.ply", {"encoding": "ascii"}),
        ("a.ply", {"encoding": "binary"}),
        ("a.stl", {}),
        ("a.stl", {"file_type": "stl_ascii"}),
        ("a.glb", {}),
    ],
)
def test_a_mesh_comes_back(box, tmp_path, name, how):
    box.export(tmp_path / name, **how)
    shape = read_shape(tmp_path / name)
    assert shape.points is None and shape.vertices is not None and len(shape.vertices) == 8
    assert np.allclose(np.sort(corners(shape), 0), np.sort(box.triangles, 0), atol=1e-6)
    if name not in ("a.stl", "a.off"):  # which hold no colours, or are written without
        assert np.array_equal(shape.colours, box.visual.vertex_colors[:, :3])
    assert shape.unit == ("m" if name == "a.glb" else None)


@pytest.mark.parametrize("name", ["a.ply", "a.obj", "a.off"])
def test_vertices_keep_the_order_of_the_file(box, tmp_path, name):
    box.export(tmp_path / name)
    shape = read_shape(tmp_path / name)
    assert np.allclose(shape.positions, box.vertices) and np.array_equal(shape.faces, box.faces)


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_the_parts_of_a_scene_are_placed_and_merged(box, tmp_path, suffix):
    scene = trimesh.Scene()
    for x in (0, 10):
        scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([x, 0, 0]))
    scene.export(tmp_path / f"scene.{suffix}")
    shape = read_shape(tmp_path / f"scene.{suffix}")
    assert len(shape.positions) == 16
    assert np.allclose(np.ptp(shape.positions, axis=0), [11, 2, 3])


def test_polygons_become_fans_and_negative_numbers_count_back(tmp_path):
    (tmp_path / "a.obj").write_text(QUADS + "f 1 2 3 4\nf -5/1/2 -4// 5 # comment\n")
    with pytest.raises(ValueError, match="line 7 is"):
        read_shape(tmp_path / "a.obj")  # a comment does not end a line of OBJ
    (tmp_path / "a.obj").write_text(QUADS + "o name\nf 1 2 \\\n 3 4\nf -5/1/2 -4// 5\n")
    assert read_shape(tmp_path / "a.obj").faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 4]]


def test_texture_coordinates_of_an_obj_need_one_a_vertex(tmp_path):
    text = QUADS + "vt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 2\nf 1/1/1 2/2/1 3/3/1\n"
    (tmp_path / "a.obj").write_text(text)
    shape = read_shape(tmp_path / "a.obj")
    assert shape.uv[:3].tolist() == [[0, 0], [1, 0], [1, 1]]
    assert shape.normals[:3].tolist() == [[0, 0, 1]] * 3 and not shape.normals[3:].any()
    (tmp_path / "a.obj").write_text(text + "f 1/3/1 3/3/1 4/2/1\n")
    assert read_shape(tmp_path / "a.obj").uv is None


def test_binary_ply_may_mix_triangles_and_quads(tmp_path):
    header = (
        "ply\nformat binary_big_endian 1.0\ncomment mixed\nelement vertex 5\nproperty float x\n"
        "property float y\nproperty double z\nelement face 2\nproperty uchar flags\n"
        "property list uchar int vertex_indices\nelement edge 1\nproperty int vertex1\nend_header\n"
    )
    v = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 2)]
    body = b"".join(struct.pack(">ffd", *p) for p in v)
    body += struct.pack(">BB4i", 7, 4, 0, 1, 2, 3) + struct.pack(">BB3i", 7, 3, 0, 1, 4)
    (tmp_path / "a.ply").write_bytes(header.encode() + body + struct.pack(">i", 1))
    shape = read_shape(tmp_path / "a.ply")
    assert shape.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 4]]
    assert np.array_equal(shape.vertices, v)


def test_off_with_normals_colours_and_quads(tmp_path):
    rows = "0 0 0  0 0 2  255 0 0\n1 0 0  0 0 2  0 255 0\n1 1 0  0 0 2  0 0 255\n"
    (tmp_path / "a.off").write_text(f"CNOFF\n# a comment\n3 1 0\n{rows}3 0 1 2  0.5 0.5 0.5\n")
    shape = read_shape(tmp_path / "a.off")
    assert shape.normals.tolist() == [[0, 0, 1]] * 3
    assert np.array_equal(shape.colours, 255 * np.eye(3))


# --------------------------------------------------------------------------------------- clouds


@pytest.fixture
def cloud() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(60, 3)).astype(np.float32).astype(float)


@pytest.mark.parametrize(
    "header, separator",
    [("", " "), ("# x y z\n", ", "), ("//X Y Z\n", ";"), ("x,y,z\n", ","), ("60\n", "\t")],
)
def test_tables_of_text(cloud, tmp_path, header, separator):
    lines = [separator.join(map(repr, row)) for row in cloud.tolist()]
    (tmp_path / "a.pts").write_text(header + "\n".join(lines) + "\n\n")
    assert np.array_equal(read_shape(tmp_path / "a.pts").points, cloud)


def test_normals_and_colours_of_a_table_are_told_apart(cloud, tmp_path):
    normals = cloud / np.linalg.norm(cloud, axis=1, keepdims=True)
    colours = np.random.default_rng(1).integers(0, 256, (60, 3))
    for columns in ((normals, colours), (colours, normals), (colours,), (normals,)):
        np.savetxt(tmp_path / "a.xyz", np.hstack([cloud, *columns]))
        shape = read_shape(tmp_path / "a.xyz")
        assert (shape.normals is None) != any(x is normals for x in columns)
        assert (shape.colours is None) != any(x is colours for x in columns)
        assert shape.colours is None or np.array_equal(shape.colours, colours)
        assert shape.normals is None or np.allclose(shape.normals, normals)
    intensity = np.linspace(-2000, 2000, 60)[:, None]  # of a .pts: x y z i r g b
    np.savetxt(tmp_path / "a.pts", np.hstack([cloud, intensity, colours]))
    assert np.array_equal(read_shape(tmp_path / "a.pts").colours, colours)


@pytest.mark.parametrize("form", ["ascii", "binary", "binary_compressed"])
def test_pcd_with_holes_normals_and_colours(cloud, tmp_path, form):
    cloud[7], colours = np.nan, np.arange(180).reshape(60, 3)
    path = write_pcd(tmp_path / "a.pcd", cloud, colours, form, height=2)
    shape, seen = read_shape(path), np.arange(60) != 7
    assert shape.missing == 1 and np.allclose(shape.points, cloud[seen], rtol=1e-6)
    assert np.array_equal(shape.colours, colours[seen])
    assert np.allclose(shape.normals, [0, 0, 1])
    with pytest.raises(ValueError, match="finite points, 1 of 60 are not"):
        read_shape(write_pcd(tmp_path / "b.pcd", cloud, colours, form, height=1))


def write_pcd(path, cloud, colours, form, height):
    packed = (colours << np.array([16, 8, 0])).sum(1).astype("<u4").view("<f4")
    columns = np.hstack([cloud, np.tile([0, 0, 3], (60, 1))]).astype("<f4")
    table = np.hstack([columns, packed[:, None]])
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z normal_x normal_y normal_z rgb\n"
        "SIZE 4 4 4 4 4 4 4\nTYPE F F F F F F F\nCOUNT 1 1 1 1 1 1 1\n"
        f"WIDTH {60 // height}\nHEIGHT {height}\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 60\nDATA {form}\n"
    ).encode()
    if form == "ascii":
        body = "\n".join(" ".join(f"{x:.9g}" for x in row) for row in table).encode() + b"\n"
    elif form == "binary":
        body = table.tobytes()
    else:
        whole = np.ascontiguousarray(table.T).tobytes()
        packed_bytes = pack_lzf(whole)
        assert len(packed_bytes) < len(whole)
        body = struct.pack("<II", len(packed_bytes), len(whole)) + packed_bytes
    path.write_bytes(header + body)
    return path


def pack_lzf(data: bytes) -> bytes:
    """A plain LZF packer: copies of what began three bytes alike last time, literals otherwise."""
    out, literals, seen, i = bytearray(), bytearray(), {}, 0

    def flush() -> None:
        for k in range(0, len(literals), 32):
            run = literals[k : k + 32]
            out.extend(bytes([len(run) - 1]) + run)
        literals.clear()

    while i < len(data):
        key, start = data[i : i + 3], seen.get(data[i : i + 3])
        seen[key] = i
        length = 0
        if start is not None and len(key) == 3 and i - start <= 8192:
            while (
                length < 264 and i + length < len(data) and data[start + length] == data[i + length]
            ):
                length += 1
        if length < 3:
            literals.append(data[i])
            i += 1
            continue
        flush()
        back, size = i - start - 1, length - 2
        out += bytes([min(size, 7) << 5 | back >> 8])
        out += bytes([size - 7] if size >= 7 else []) + bytes([back & 255])
        i += length
    flush()
    return bytes(out)


def test_lzf_unpacks_what_was_packed_and_refuses_damage():
    for data in (b"a" * 1000, bytes(range(256)) * 3, b"", b"abcabcabcabd" * 40):
        assert expand_lzf(pack_lzf(data), len(data)) == data
    with pytest.raises(ValueError, match="must unpack to 4 bytes, got 3"):
        expand_lzf(b"\x02abc", 4)
    with pytest.raises(ValueError, match="damaged"):
        expand_lzf(b"\x20\xff", 4)


def test_npz_keeps_what_lies_beside_the_points(cloud, tmp_path):
    colours = np.full((60, 3), 0.5)
    np.savez(tmp_path / "a.npz", points=cloud, normals=3 * cloud, colours=colours, unit="mm")
    shape = read_shape(tmp_path / "a.npz")
    assert np.allclose(np.linalg.norm(shape.normals, axis=1), 1) and shape.unit == "mm"
    assert (shape.colours == 128).all()


def test_a_cloud_to_encode_is_the_points_or_samples_of_the_mesh(box, cloud, tmp_path):
    np.savetxt(tmp_path / "a.xyz", cloud)
    assert np.allclose(read_shape(tmp_path / "a.xyz").cloud(5), cloud)
    box.export(tmp_path / "a.ply")
    samples = read_shape(tmp_path / "a.ply").cloud(300)
    assert samples.shape == (300, 3) and np.allclose(
        np.abs(box.bounds).max(), np.abs(samples).max(), atol=0.2
    )


@pytest.mark.parametrize("name", ["a.xyz", "a.ply"])
def test_large_clouds_are_streamed(tmp_path, name):
    """Peak memory is a small multiple of the points', whatever the text around them weighs."""
    points = np.random.default_rng(0).normal(size=(40_000, 3))
    if name == "a.xyz":
        np.savetxt(tmp_path / name, points)
    else:
        trimesh.PointCloud(points).export(tmp_path / name, encoding="ascii")
    tracemalloc.start()
    shape = read_shape(tmp_path / name)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert shape.points.shape == points.shape
    assert peak < 4.5 * points.nbytes  # as a list of lines it would be 8 times as much or more
