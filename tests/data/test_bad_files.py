"""Whatever is wrong with a file is said in one line that names it; nothing is cut in silence."""

import os
from pathlib import Path

import numpy as np
import pytest

from riemlayer.data import read_shape
from riemlayer.data.readers import SUFFIXES

pytest.importorskip("trimesh")
import trimesh


def refused(path: Path, words: str) -> None:
    """Reading raises one line that begins with the file's name and holds these words."""
    with pytest.raises((ValueError, OSError), match=words) as raised:
        read_shape(path)
    message = str(raised.value)
    assert message.startswith(f"{path}: ") and "\n" not in message


def write(folder: Path, name: str) -> Path:
    """A good file of each format: a sphere, or a cloud of its vertices."""
    path, sphere = folder / name, trimesh.creation.icosphere(1)
    v = np.asarray(sphere.vertices)
    if path.suffix in (".xyz", ".pts", ".txt"):
        np.savetxt(path, v, "%.9f", header=str(len(v)), comments="")
    elif path.suffix == ".npz":
        np.savez(path, vertices=v, faces=sphere.faces)
    elif path.suffix == ".pcd":
        header = (
            "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
            f"WIDTH {len(v)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(v)}\nDATA binary\n"
        )
        path.write_bytes(header.encode() + v.astype("<f4").tobytes())
    else:
        stem = path.stem
        how = {"encoding": "ascii"} if stem == "text" and path.suffix == ".ply" else {}
        how = {"file_type": "stl_ascii"} if stem == "text" and path.suffix == ".stl" else how
        sphere.export(path, **how)
    return path


NAMES = ["a.obj", "a.off", "a.ply", "text.ply", "a.stl", "text.stl", "a.glb", "a.xyz", "a.pcd"]
NAMES += ["a.npz"]


@pytest.mark.parametrize("name", NAMES)
def test_good_files_are_read(tmp_path, name):
    assert len(read_shape(write(tmp_path, name)).positions) == 42


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_missing_empty_and_directory(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    refused(path, "found none there")
    path.mkdir()
    refused(path, "this is a directory; name one in it")
    path.rmdir()
    path.touch()
    refused(path, r"is empty \(0 bytes\)")


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="permissions of POSIX")
def test_a_file_that_may_not_be_read(tmp_path, monkeypatch):
    path = write(tmp_path, "a.obj")
    path.chmod(0)
    if os.geteuid() == 0:  # to whom everything is permitted

        def denied(*_, **__):
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr(Path, "open", denied)
    refused(path, r"may not be read; allow it with chmod u\+r")


@pytest.mark.parametrize("name", [n for n in NAMES if n not in ("a.obj", "text.stl")])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_files_cut_short(tmp_path, name, share):
    """An .obj says nowhere how much it holds: there, a whole line less is not to be noticed."""
    path = write(tmp_path, name)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    refused(path, ".")


def test_solids_and_lines_cut_short(tmp_path):
    path = write(tmp_path, "text.stl")
    text = path.read_text()
    path.write_text(text + text[: len(text) // 2])
    refused(path, "must close its 2 solids, 1 are closed; is it cut short")
    path = write(tmp_path, "a.obj")
    path.write_text(path.read_text().split("f ")[0] + "f 1 2")
    refused(path, "must hold faces")
    path.write_text("v 1 2 3\nv 4 5\n")
    refused(path, "line 2 is 'v 4 5'")


@pytest.mark.parametrize("name", ["a.obj", "a.off", "text.ply", "text.stl", "a.xyz"])
@pytest.mark.parametrize("word", ["abc", "1.0.0", "nan", "inf", "1e300", "1_0", "0x1F", "١"])
def test_a_word_in_a_numbers_place(tmp_path, name, word):
    path = write(tmp_path, name)
    number = "0.850650"[:6]
    text = path.read_text()
    assert number in text
    at = text.index(number)
    end = at + len(text[at:].split()[0])
    path.write_text(text[:at].rstrip("-") + word + text[end:], encoding="utf-8")
    refused(path, ".")


@pytest.mark.parametrize("name", ["a.off", "text.ply", "a.pcd", "a.xyz"])
@pytest.mark.parametrize("declared", ["41", "43", "4000000000"])
def test_a_wrong_number_of_points(tmp_path, name, declared):
    path = write(tmp_path, name)
    data = path.read_bytes()
    path.write_bytes(data.replace(b"42", declared.encode(), 4 if name == "a.pcd" else 1))
    assert path.read_bytes() != data
    refused(path, ".")


@pytest.mark.parametrize(
    "name, content, words",
    [
        ("a.xyz", "1 2 3\n1 2\n", "equally many numbers a line"),
        ("a.xyz", "one two three\n", "at least 4 points"),
        ("a.xyz", "1 2 3\none two three\n", "could not convert string 'one'"),
        ("a.xyz", "1 2 3\n" * 3, r"at least 4 points .* got \(3, 3\); is it cut short"),
        ("a.xyz", "1 2\n" * 9, r"three numbers a line, got \(9, 2\)"),
        ("a.xyz", "1 2 3\n" * 9, "all of them are equal"),
        ("a.xyz", "1 2 3\n4 5 nan\n6 7 8\n9 9 9\n", "1 of 4 are not; remove those"),
        ("a.xyz", "1 2 3\n4 5 1e200\n6 7 8\n9 9 9\n", "up to 1e[+]100"),
        ("a.step", "solid", r"end in one of \.obj .*begins like \.stl"),
        ("a.obj", "v 0 0 0\n", r"at least 4 points .* got \(1, 3\)"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "got indices from 0 to 3"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n", "got indices from -1 to 1"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n", "line 4"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "with an area"),
        ("a.obj", "ply\nformat ascii 1.0\n", r"line 1 is 'ply' \(its content begins like \.ply"),
        ("a.ply", "ply\nthis is no header", "PLY header, got the line 'this is no header'"),
        ("a.ply", "OFF\n3 1 0\n", r"begin with `ply`.*begins like \.off: rename it"),
        ("a.off", "8OFF\n1 0 0\n0 0 0\n", "must begin with OFF, got '8OFF'"),
        ("a.off", "OFF\n4 0 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n9 9 9\n", "more lines follow"),
        ("a.glb", "this is text", "glb"),
        ("a.gltf", "{}", "holds neither"),
        ("a.npz", "this is text", "npz"),
        ("a.pcd", "VERSION 0.7\nFIELDS x y\nDATA ascii\n", "SIZE is missing"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, name, content, words):
    (tmp_path / name).write_text(content)
    refused(tmp_path / name, words)


@pytest.mark.parametrize(
    "arrays, words",
    [
        ({"weights": np.zeros(3)}, r"must hold `points`.* got \['weights'\]"),
        ({"points": np.array([["a"] * 3] * 4)}, "numbers in `points`, got <U1"),
        ({"points": np.zeros((4, 3), object)}, "allow_pickle"),
        ({"points": np.zeros((2, 4, 3))}, r"got \(2, 4, 3\)"),
        ({"vertices": np.eye(3), "faces": np.array([[0, 1, 1.5]])}, "whole numbers in its faces"),
        ({"vertices": np.eye(3), "faces": np.array([[0, 1, 7]])}, "from 0 to 7"),
        ({"vertices": np.eye(3), "faces": np.zeros((0, 3))}, "point cloud"),
        ({"V": np.eye(3), "F": np.array([[0, 1, 2]]), "points": np.zeros((9, 3))}, "are equal"),
    ],
)
def test_archives_without_a_shape(tmp_path, arrays, words):
    np.savez(tmp_path / "a.npz", **arrays)
    refused(tmp_path / "a.npz", words)


def test_collada_says_what_to_install(tmp_path):
    (tmp_path / "a.dae").write_text("<COLLADA/>")
    try:
        import collada  # noqa: F401
    except ImportError:
        refused(tmp_path / "a.dae", "pip install pycollada")
    else:
        refused(tmp_path / "a.dae", "dae")


@pytest.mark.parametrize("name", ["a.obj", "a.off", "a.ply", "a.glb", "a.xyz", "a.npz"])
@pytest.mark.parametrize("scale, shift", [(1e-3, 0), (1e3, 0), (1e9, 0), (1.0, 1e6)])
def test_the_unit_does_not_matter(tmp_path, name, scale, shift):
    """Metres, millimetres, kilometres, and UTM: the same cloud up to the unit."""
    one = read_shape(write(tmp_path, name))
    sphere = trimesh.creation.icosphere(1)
    if shift and name in ("a.ply", "a.glb"):
        pytest.skip("written in float32, which a shift of 1e6 leaves one digit")
    other_path = tmp_path / f"other{Path(name).suffix}"
    v = scale * np.asarray(sphere.vertices) + shift
    if name == "a.xyz":
        np.savetxt(other_path, v, fmt="%.17g")
    elif name == "a.npz":
        np.savez(other_path, vertices=v, faces=sphere.faces)
    else:
        digits = {} if name in ("a.ply", "a.glb") else {"digits": 16}
        trimesh.Trimesh(v, sphere.faces, process=False).export(other_path, **digits)
    other = read_shape(other_path)
    back = (other.cloud(200) - shift) / scale
    assert np.allclose(back, one.cloud(200), atol=2e-6 + 1e-9 * shift)
