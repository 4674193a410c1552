"""Bad input to every subcommand: one line that names it, exit code 2, nothing left behind."""

import numpy as np
import pytest

BALL = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n"
PLY = b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\n"
PLY += b"property float y\nproperty float z\nend_header\n" + bytes(40)


def npz(path, **arrays):
    with open(path, "wb") as file:
        np.savez(file, **arrays)


BAD = {
    "missing.ply": None,
    "folder.obj": lambda path: path.mkdir(),
    "empty.ply": lambda path: path.write_bytes(b""),
    "truncated.ply": lambda path: path.write_bytes(PLY),
    "truncated.npz": lambda path: path.write_bytes(b"PK\x03\x04" + bytes(30)),
    "wrong.docx": lambda path: path.write_text(BALL),
    "renamed.ply": lambda path: path.write_text(BALL),
    "words.xyz": lambda path: path.write_text("0 0 0\n1 one 1\n0 1 0\n0 0 1\n2 2 2\n"),
    "words.obj": lambda path: path.write_text(BALL.replace("v 1 0 0", "v one 0 0")),
    "nan.xyz": lambda path: path.write_text("0 0 0\n1 nan 1\n0 1 0\n0 0 1\n2 2 2\n"),
    "flat.obj": lambda path: path.write_text("v 0 0 0\nv 1 1 1\nv 2 2 2\nf 1 2 3\n"),
    "equal.npz": lambda path: npz(path, points=np.ones((9, 3))),
    "huge.npz": lambda path: npz(path, points=1e200 * np.eye(9, 3)),
    "pickled.npz": lambda path: npz(path, points=np.array([{}], object)),
    "faces.npz": lambda path: npz(path, vertices=np.eye(4, 3), faces=np.array([[0, 1, 9]])),
}
"""What is wrong with a file, by its name."""
ASKING = {
    "log": ["--source", "0"],
    "exp": ["--source", "0"],
    "geodesic": ["--source", "0", "--target", "1"],
    "stitch": ["--source", "0"],
    "decal": ["--source", "0"],
    "mean": ["-p", "0"],
    "view": ["--no-browser"],
    "info": [],
    "bench": [],
}
"""Subcommands that read a shape, and what else they need."""


def refused(done, *words):
    """The call ended with 2, and one line that has these words."""
    assert done.code == 2, (done.code, done.stdout, done.stderr)
    assert done.stderr.count("\n") == 1 and done.stdout == "", (done.stdout, done.stderr)
    assert "Traceback" not in done.stderr
    assert all(word in done.stderr for word in words), done.stderr


@pytest.fixture
def bad(tmp_path):
    """Makes a bad file of that name."""

    def make(name):
        path = tmp_path / "in" / name
        path.parent.mkdir(exist_ok=True)
        if BAD[name] is not None:
            BAD[name](path)
        return path

    return make


@pytest.mark.parametrize("name", BAD)
@pytest.mark.parametrize("command", ASKING)
def test_bad_files(run, tmp_path, bad, command, name):
    path, out = bad(name), tmp_path / "out.html"
    written = [] if command in ("info", "bench") else ["-o", out]
    refused(run(command, path, *ASKING[command], *written), f"riemlayer {command}: ", name)
    assert not out.exists()


@pytest.fixture
def asked(run, shapes, tiny):
    """Asks for the log map of the cloud, with these words besides."""

    def call(*words, command="log"):
        return run(command, shapes / "cloud.npz", *words, "--weights", tiny)

    return call


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ([], "--source"),
        (["--source", "0", "--at", "0,0,0"], "--at"),
        (["--source", "600"], "0 to 599"),
        (["--source", "-1"], "0 to 599"),
        (["--source", "two"], "--source"),
        (["--at", "1,2"], "--at"),
        (["--at", "1,2,x"], "--at"),
        (["--at", "1,2,nan"], "--at"),
        (["--at", "1000,0,0"], "unit"),
        (["--at", "1e300,0,0"], "unit"),
        (["--source", "0", "--device", "toaster"], "--device"),
        (["--source", "0", "--points", "3"], "--points"),
        (["--source", "0", "--sauce", "3"], "--sauce"),
    ],
)
def test_bad_sources_and_options(asked, tmp_path, words, named):
    refused(asked(*words, "-o", tmp_path / "out.npz"), named)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("out", "named"),
    [
        ("out.docx", ".npz .ply .obj .png .html"),
        ("out", ".npz"),
        ("none/out.npz", "mkdir"),
        ("folder.npz", "folder"),
        ("there.npz", "--force"),
    ],
)
def test_bad_targets(asked, tmp_path, out, named):
    (tmp_path / "folder.npz").mkdir()
    (tmp_path / "there.npz").write_bytes(b"mine")
    refused(asked("--source", 0, "-o", tmp_path / out), "--out", named)
    assert (tmp_path / "there.npz").read_bytes() == b"mine"
    assert len(list(tmp_path.iterdir())) == 2


def test_an_existing_target_is_replaced_with_force(asked, tmp_path):
    (tmp_path / "there.npz").write_bytes(b"mine")
    assert asked("--source", 0, "-o", tmp_path / "there.npz", "--force").code == 0
    assert (tmp_path / "there.npz").read_bytes() != b"mine"


def test_a_target_that_may_not_be_written(asked):
    refused(asked("--source", 0, "-o", "/proc/out.npz"), "/proc")


def test_a_full_disk_leaves_the_older_target(asked, monkeypatch, tmp_path):
    def full(path, arrays):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device", str(path))

    (tmp_path / "there.npz").write_bytes(b"mine")
    monkeypatch.setattr("riemlayer.cli.output.write_npz", full)
    refused(asked("--source", 0, "-o", tmp_path / "there.npz", "--force"), "No space left")
    assert [x.name for x in tmp_path.iterdir()] == ["there.npz"]
    assert (tmp_path / "there.npz").read_bytes() == b"mine"


@pytest.mark.parametrize("link", [False, True])
def test_input_is_never_written_to(run, shapes, tiny, tmp_path, link):
    shape = tmp_path / "shape.npz"
    shape.write_bytes((shapes / "cloud.npz").read_bytes())
    before, out = shape.read_bytes(), tmp_path / ("link.npz" if link else "shape.npz")
    if link:
        out.symlink_to(shape)
    for command in ("log", "exp", "stitch", "decal"):
        done = run(command, shape, "-s", 0, "-o", out, "--force", "--weights", tiny)
        refused(done, "never written to")
    assert shape.read_bytes() == before


VECTORS = {
    "missing.npy": None,
    "folder.npy": lambda path: path.mkdir(),
    "empty.npy": lambda path: path.write_bytes(b""),
    "text.npy": lambda path: path.write_text("1 2 3"),
    "cut.npy": lambda path: path.write_bytes(b"\x93NUMPY\x01\x00v\x00{'descr': '<f8'"),
    "pickled.npy": lambda path: np.save(path, np.array([{}], object), allow_pickle=True),
    "nan.npy": lambda path: np.save(path, np.array([[0, np.nan, 0]])),
    "words.npy": lambda path: np.save(path, np.array([["a", "b", "c"]])),
    "none.npy": lambda path: np.save(path, np.zeros((0, 3))),
    "long.npy": lambda path: np.save(path, np.full((5, 3), 1e300)),
    "wide.npy": lambda path: np.save(path, np.zeros((5, 4))),
}


@pytest.mark.parametrize("name", VECTORS)
def test_bad_vectors(asked, tmp_path, name):
    path = tmp_path / name
    if VECTORS[name] is not None:
        VECTORS[name](path)
    done = asked("--source", 0, "--vectors", path, "-o", tmp_path / "o.npz", command="exp")
    refused(done, name)
    assert not (tmp_path / "o.npz").exists()


@pytest.mark.parametrize(
    ("command", "words", "named"),
    [
        ("geodesic", ["-s", "0"], "--target"),
        ("geodesic", ["-s", "0", "--target", "600"], "--target"),
        ("geodesic", ["-s", "0", "--to", "a,b,c"], "--to"),
        ("geodesic", ["-s", "0", "--target", "1", "--samples", "1"], "--samples"),
        ("stitch", ["-s", "0", "--depth", "-1"], "--depth"),
        ("stitch", ["-s", "0", "--radius", "0"], "--radius"),
        ("stitch", ["-s", "0", "--radius", "nan"], "--radius"),
        ("decal", ["-s", "0", "--size", "-1"], "--size"),
        ("decal", ["-s", "0", "--up", "0,0,0"], "--up"),
        ("decal", ["-s", "0", "--image", "none.png"], "none.png"),
        ("mean", [], "--point"),
        ("mean", ["-p", "600"], "--point"),
        ("mean", ["--among", "none.npy"], "none.npy"),
        ("view", ["--at", "1"], "--at"),
        ("view", ["--port", "70000"], "--port"),
        ("info", ["--weights", "nothing"], "--weights nothing"),
        ("bench", ["--repeats", "0"], "--repeats"),
    ],
)
def test_what_else_may_be_wrong(run, shapes, tiny, tmp_path, command, words, named):
    out = ["-o", tmp_path / "out.npz"] if command in ("geodesic", "stitch", "decal", "mean") else []
    weights = [] if "--weights" in words else ["--weights", tiny]
    refused(run(command, shapes / "cloud.npz", *words, *out, *weights), named)
    assert not list(tmp_path.iterdir())


def test_masses_must_fit_the_points(asked, tmp_path):
    np.save(tmp_path / "m.npy", np.ones(3))
    words = ["-p", 0, "-p", 1, "--masses", tmp_path / "m.npy", "-o", tmp_path / "o.npz"]
    refused(asked(*words, command="mean"), "m.npy", "2 weights")
    np.save(tmp_path / "m.npy", np.array([-1, 2]))
    refused(asked(*words, command="mean"), "m.npy", "not negative")


def test_a_picture_that_is_none(asked, tmp_path):
    pytest.importorskip("PIL")
    (tmp_path / "p.png").write_bytes(b"\x89PNG\r\n")
    words = ["-s", 0, "--image", tmp_path / "p.png", "-o", tmp_path / "o.npz"]
    refused(asked(*words, command="decal"), "p.png")


def test_weights_that_are_none(run, shapes, tmp_path):
    words = ["log", shapes / "cloud.npz", "-s", 0, "-o", tmp_path / "o.npz", "--weights"]
    refused(run(*words, "nothing"), "--weights", "nothing")
    (tmp_path / "w").mkdir()
    refused(run(*words, tmp_path / "w"), "--weights", "model.safetensors")
    (tmp_path / "w" / "model.safetensors").write_bytes(b"cut")
    (tmp_path / "w" / "config.json").write_text("{}")
    refused(run(*words, tmp_path / "w"), "--weights", "config.json")
    assert not (tmp_path / "o.npz").exists()


def test_no_such_subcommand(run):
    refused(run("lgo"), "lgo", "riemlayer --help")
