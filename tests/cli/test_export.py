"""`riemlayer export`: the decoders as programs."""

import numpy as np
import pytest
import torch
from references import lumpy

from riemlayer import ExpLogField, deploy


@pytest.mark.slow
@torch.no_grad()
def test_programs_are_the_decoder_of_the_weights(well, tiny, tmp_path):
    pytest.importorskip("onnxscript", reason="needs the extra `deploy`")
    runtime = pytest.importorskip("onnxruntime", reason="needs the extra `deploy`")
    torch_file, onnx_file = tmp_path / "log.pt2", tmp_path / "log.onnx"
    words = ["--exported-program", torch_file, "--onnx", onnx_file, "--json"]
    done = well("export", tiny, "--map", "log", *words)
    files = {"exported_program": str(torch_file), "onnx": str(onnx_file)}
    assert done.facts == {"map": "log"} | files and done.stderr == ""
    field = ExpLogField.from_pretrained(tiny)
    points = lumpy(200, torch.float32)
    query = deploy.prepare(field.encode(points), "log", points[:3, None], points[None, :9])
    expected = [x.numpy() for x in deploy.Decoder(field, "log")(**query.inputs)]
    session = runtime.InferenceSession(onnx_file, providers=["CPUExecutionProvider"])
    answers = [
        session.run(None, {name: x.numpy() for name, x in query.inputs.items()}),
        torch.export.load(torch_file).module()(**query.inputs),
    ]
    for answer in answers:
        for got, wanted in zip(answer, expected, strict=True):
            np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    "words, named",
    [
        ("", ["nothing to write", "--onnx"]),
        ("--onnx a.onnx", ["--onnx", "--map"]),
        ("--map exp", ["--map", "--exported-program"]),
        ("--map exp --onnx a.txt", ["--onnx", ".onnx", "a.txt"]),
        ("--map exp --exported-program a.onnx", ["--exported-program", ".pt2"]),
        ("--map exp --onnx old.onnx", ["--onnx", "exists", "--force"]),
        ("--map exp --onnx none/a.onnx", ["--onnx", "mkdir"]),
        ("--map exp --onnx a.onnx --facts a.json", ["--facts", "--out"]),
        ("--map dist --onnx a.onnx", ["--map", "dist"]),
    ],
)
def test_what_cannot_be_written_is_named(run, tiny, tmp_path, monkeypatch, words, named):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old.onnx").touch()
    done = run("export", tiny, *words.split())
    assert done.code == 2 and done.stderr.count("\n") == 1, done.stderr
    assert all(word in done.stderr for word in named), done.stderr
    assert [x.name for x in tmp_path.iterdir()] == ["old.onnx"]


def test_weights_that_do_not_exist_are_named(run, tmp_path):
    done = run("export", "nowhere", "--map", "exp", "--exported-program", tmp_path / "a.pt2")
    assert done.code == 2 and "nowhere" in done.stderr and not list(tmp_path.iterdir())
