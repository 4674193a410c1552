"""Damaged files, thousands of them: a shape one can encode, or one line that names the file."""

import random
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from riemlayer.data import RawShape, read_shape
from riemlayer.data.readers import SUFFIXES

pytest.importorskip("trimesh")
import trimesh

ROUNDS = 60
"""Damaged copies of each good file: a few seconds for all of them."""


def sound(shape: RawShape) -> None:
    """What every answer promises."""
    x = shape.positions
    assert x.ndim == 2 and x.shape[1] == 3 and len(x) >= 3 and x.dtype == np.float64
    assert np.isfinite(x).all() and (x != x[0]).any()
    if shape.faces is not None:
        assert shape.vertices is not None and shape.faces.dtype == np.int64
        assert shape.faces.min() >= 0 and shape.faces.max() < len(shape.vertices)
    for beside in (shape.normals, shape.colours, shape.uv):
        assert beside is None or (len(beside) == len(x) and np.isfinite(beside).all())


def read_or_refuse(path: Path) -> None:
    try:
        shape = read_shape(path)
    except (ValueError, OSError) as error:
        assert str(error).startswith(f"{path}: ") and "\n" not in str(error)
    else:
        sound(shape)


# ------------------------------------------------------------------------------------- mutations


def seeds() -> dict[str, bytes]:
    """One small good file of each format and encoding."""
    mesh = trimesh.creation.icosphere(0)
    mesh.visual.vertex_colors = np.full((12, 4), 200, np.uint8)
    table = "\n".join(" ".join(f"{x:.3f}" for x in row) for row in mesh.vertices)
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        "WIDTH 6\nHEIGHT 2\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 12\nDATA "
    )
    raw = mesh.vertices.astype("<f4").tobytes()
    literal = b"".join(bytes([15]) + raw[i : i + 16] for i in range(0, 144, 16))
    sizes = np.array([len(literal), 144], "<u4").tobytes()
    files = {
        "a.xyz": f"12\n{table}\n".encode(),
        "ascii.pcd": f"{header}ascii\n{table}\n".encode(),
        "binary.pcd": f"{header}binary\n".encode() + raw,
        "packed.pcd": f"{header}binary_compressed\n".encode() + sizes + literal,
    }
    for name, how in (
        ("a.obj", {}),
        ("a.off", {}),
        ("a.stl", {}),
        ("ascii.stl", {"file_type": "stl_ascii"}),
        ("a.ply", {}),
        ("ascii.ply", {"file_type": "ply", "encoding": "ascii"}),
        ("a.glb", {}),
    ):
        data = mesh.export(**({"file_type": Path(name).suffix[1:]} | how))
        files[name] = data.encode() if isinstance(data, str) else data
    return files


def damaged(data: bytes, rng: random.Random) -> bytes:
    """A copy with one to four bytes, pieces or numbers changed."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        i, n = rng.randrange(len(out) + 1), rng.choice((1, 1, 4, 16, 64))
        match rng.randrange(6):
            case 0:
                out[i : i + n] = rng.randbytes(n)
            case 1:
                del out[i : i + n]
            case 2:
                out[i:i] = out[max(0, i - n) : i]
            case 3:
                out[i : i + 1] = bytes([(out[i] if i < len(out) else 0) ^ 1 << rng.randrange(8)])
            case 4:
                word = (
                    b"-1",
                    b"nan",
                    b"1e400",
                    b"99999999999",
                    b"\n",
                    b" ",
                    b"\xff" * 4,
                    b"\0" * 4,
                )
                out[i : i + n] = rng.choice(word)
            case _:
                digits = [j for j, byte in enumerate(out[:400]) if 48 <= byte <= 57]
                if digits:
                    out[rng.choice(digits)] = rng.randrange(48, 58)
    return bytes(out)


SEEDS = seeds()


@pytest.mark.parametrize("name", [*SEEDS, "a.npz"])
def test_damaged_files_are_read_or_refused(tmp_path, name):
    path = tmp_path / name
    if name == "a.npz":
        mesh = trimesh.creation.icosphere(0)
        np.savez(path, vertices=mesh.vertices, faces=mesh.faces)
        SEEDS[name] = path.read_bytes()
    path.write_bytes(SEEDS[name])
    sound(read_shape(path))
    rng = random.Random(name)
    for _ in range(ROUNDS):
        path.write_bytes(damaged(SEEDS[name], rng))
        read_or_refuse(path)


@pytest.mark.parametrize("name", [*SEEDS])
def test_files_of_one_format_under_the_name_of_another(tmp_path, name):
    for suffix in SUFFIXES:
        path = tmp_path / f"other{suffix}"
        path.write_bytes(SEEDS[name])
        read_or_refuse(path)


# ------------------------------------------------------------------------------------ properties

QUIET = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@QUIET
@given(suffix=st.sampled_from(SUFFIXES), data=st.binary(max_size=200))
def test_arbitrary_bytes_are_read_or_refused(tmp_path, suffix, data):
    path = tmp_path / f"any{suffix}"
    path.write_bytes(data)
    read_or_refuse(path)


@QUIET
@given(
    rows=st.lists(st.lists(st.floats(width=64), min_size=1, max_size=8), min_size=1, max_size=8),
    separator=st.sampled_from([" ", ",", "\t", " ; "]),
)
def test_a_table_is_its_points_or_refused(tmp_path, rows, separator):
    """Never fewer points than lines, nor other ones."""
    path = tmp_path / "a.xyz"
    path.write_text("\n".join(separator.join(map(repr, row)) for row in rows))
    x = np.array([row[:3] for row in rows]) if len({len(row) for row in rows}) == 1 else np.zeros(0)
    good = x.ndim == 2 and x.shape[1] == 3 and len(x) >= 4 and np.isfinite(x).all()
    good = good and np.abs(x).max() <= 1e100 and np.ptp(x, axis=0).max() > 1e-100
    if good:
        assert np.array_equal(read_shape(path).points, x)
    else:
        with pytest.raises(ValueError, match=r"a\.xyz: "):
            read_shape(path)


@QUIET
@given(
    points=st.lists(
        st.tuples(*[st.floats(-1e9, 1e9, width=32)] * 3), min_size=4, max_size=20, unique=True
    ),
    text=st.booleans(),
)
def test_a_ply_cloud_comes_back_to_the_bit(tmp_path, points, text):
    path, x = tmp_path / "a.ply", np.array(points, np.float64)
    form = "ascii" if text else "binary_little_endian"
    header = f"ply\nformat {form} 1.0\nelement vertex {len(x)}\n"
    header += "".join(f"property double {axis}\n" for axis in "xyz") + "end_header\n"
    body = "\n".join(" ".join(map(repr, row)) for row in x.tolist()).encode()
    path.write_bytes(header.encode() + (body if text else x.astype("<f8").tobytes()))
    assert np.array_equal(read_shape(path).points, x)
