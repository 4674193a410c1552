"""Eager preparation and an exported decoder are, together, `surface.exp` and `surface.log`."""

import contextlib
import importlib.util
import shutil
import subprocess
import sys
from dataclasses import replace

import pytest
import torch
from references import lumpy, packed, shaken
from torch import Tensor

from riemlayer import EncodedSurface, ExpLogField, FieldConfig, deploy

BATCHES = {"one query": (1, 1), "one source": (1, 300), "many": (7, 5)}
UNANCHORED = replace(FieldConfig.tiny().head, anchored=False, narrow=0, walks=0)
VARIANTS = {
    "tiny": FieldConfig.tiny(),
    "not anchored": replace(FieldConfig.tiny(), head=UNANCHORED),
    "siren": replace(FieldConfig.tiny(), head=replace(FieldConfig.tiny().head, decoder="siren")),
}


@pytest.fixture(autouse=True)
def full_precision(monkeypatch):
    """No bfloat16: programs compute in the weights' precision on every processor."""
    monkeypatch.setattr(ExpLogField, "half_precision", lambda self: contextlib.nullcontext())


@pytest.fixture(scope="module")
def field() -> ExpLogField:
    torch.manual_seed(0)
    return shaken("tiny", torch.float32, strength=0.5)


@pytest.fixture(scope="module", params=["exp", "log"])
def which(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def program(field, which) -> torch.export.ExportedProgram:
    return deploy.export(field, which)


def cloud(n: int) -> Tensor:
    """In a unit and at a place of its own."""
    return 3 * lumpy(n, torch.float32) + torch.tensor([5.0, 0.0, -2.0])


def asked(surface: EncodedSurface, which: str, sources: int, queries: int) -> tuple[Tensor, Tensor]:
    """Base points and vectors or points within the trained radius."""
    p = surface.points[:sources, None]
    v = torch.randn(sources, queries, 3)
    v = (
        0.9
        * float(surface.radius.max())
        * torch.rand(sources, queries, 1)
        * v
        / v.norm(dim=-1, keepdim=True)
    )
    return p, v if which == "exp" else p + v


def expected(surface, which, p, x, **how) -> tuple[Tensor, Tensor]:
    answer, info = getattr(surface, which)(p, x, return_info=True, **how)
    return answer, info.validity


def same(got, wanted, tolerance=1e-5) -> None:
    for a, b in zip(got, wanted, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=tolerance)


@torch.no_grad()
@pytest.mark.parametrize("which", ["exp", "log"])
@pytest.mark.parametrize("name", VARIANTS)
def test_preparation_and_decoder_are_the_map(name, which):
    model = ExpLogField(VARIANTS[name]).eval()
    for parameter in model.parameters():
        parameter.add_(torch.randn_like(parameter), alpha=0.05)
    surface = model.encode(cloud(400))
    p, x = asked(surface, which, 6, 9)
    query = deploy.prepare(surface, which, p, x)
    wanted = expected(surface, which, p, x)
    same(query.finish(*deploy.Decoder(model, which)(**query.inputs)), wanted)
    assert wanted[0].std() > 0.1 and wanted[1].std() > 1e-4  # the weights do have a say


@torch.no_grad()
def test_clouds_of_a_batch_keep_their_units(field, which):
    surface = field.encode(*packed(cloud(300), 0.1 * cloud(250)))
    shape = torch.tensor([0, 1, 1, 0])
    p = torch.stack([surface.points[surface.batch == i][k] for k, i in enumerate(shape)])[:, None]
    x = 0.1 * torch.randn(4, 6, 3) + (p if which == "log" else 0)
    query = deploy.prepare(surface, which, p, x, shape[:, None])
    got = query.finish(*deploy.Decoder(field, which)(**query.inputs))
    same(got, expected(surface, which, p, x, shape=shape[:, None]))


@torch.no_grad()
def test_a_program_takes_any_cloud_and_any_numbers(field, which, program, tmp_path):
    torch.export.save(program, tmp_path / "map.pt2")
    loaded = torch.export.load(tmp_path / "map.pt2").module()
    for n, (sources, queries) in zip((200, 500, 900), BATCHES.values(), strict=True):
        surface = field.encode(cloud(n))
        p, x = asked(surface, which, sources, queries)
        query = deploy.prepare(surface, which, p, x)
        same(query.finish(*loaded(**query.inputs)), expected(surface, which, p, x))


@torch.no_grad()
def test_onnxruntime_answers_like_the_surface(field, which, program, tmp_path):
    for package in ("onnx", "onnxscript"):
        pytest.importorskip(package, reason="needs the extra `deploy`")
    runtime = pytest.importorskip("onnxruntime", reason="needs the extra `deploy`")
    deploy.export_onnx(program, tmp_path / "map.onnx")
    assert [path.name for path in tmp_path.iterdir()] == ["map.onnx"]  # the weights are inside
    session = runtime.InferenceSession(tmp_path / "map.onnx", providers=["CPUExecutionProvider"])
    assert [x.name for x in session.get_outputs()] == ["vector", "validity"]
    for n, (sources, queries) in zip((200, 500, 900), BATCHES.values(), strict=True):
        surface = field.encode(cloud(n))
        p, x = asked(surface, which, sources, queries)
        query = deploy.prepare(surface, which, p, x)
        answer = session.run(None, {name: y.numpy() for name, y in query.inputs.items()})
        same(query.finish(*map(torch.from_numpy, answer)), expected(surface, which, p, x))


@pytest.mark.parametrize("which", ["log"], indirect=True)
def test_a_saved_program_needs_torch_alone(field, program, tmp_path):
    surface = field.encode(cloud(200))
    inputs = deploy.prepare(surface, "log", *asked(surface, "log", 3, 4)).inputs
    inputs = {name: x.detach() for name, x in inputs.items()}
    torch.save(inputs, tmp_path / "inputs.pt")
    torch.export.save(program, tmp_path / "map.pt2")
    code = (
        "import sys, torch; sys.modules['riemlayer'] = None\n"
        "program = torch.export.load('map.pt2').module()\n"
        "torch.save(program(**torch.load('inputs.pt')), 'answer.pt')"
    )
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True, capture_output=True)
    with torch.no_grad():
        same(torch.load(tmp_path / "answer.pt"), deploy.Decoder(field, "log")(**inputs))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")  # inductor's own
@torch.no_grad()
def test_compiled_decoders_answer_like_eager_ones(field):
    if not (shutil.which("g++") or shutil.which("clang++")):
        pytest.skip("torch.compile needs a C++ compiler, and there is none on the PATH")
    compiled = ExpLogField(field.config).eval()
    compiled.load_state_dict(field.state_dict())
    compiled.log_head.decoder.compile(dynamic=True)
    points = cloud(300)
    for queries in (20, 31):
        p, q = asked(field.encode(points), "log", 6, queries)
        same([compiled.encode(points).log(p, q)], [field.encode(points).log(p, q)])


def test_encode_cannot_be_exported(field):
    with pytest.raises(ValueError, match=r"encode stays eager.*'exp' or 'log'"):
        deploy.export(field, "encode")  # pyright: ignore
    with pytest.raises(RuntimeError, match=r"encode stays eager.*riemlayer.deploy.export"):
        torch.export.export(field, (cloud(100), torch.zeros(1, 3), torch.zeros(1, 3)))


def test_bad_arguments_are_named(field):
    surface = field.encode(cloud(100))
    p = surface.points[:2]
    with pytest.raises(ValueError, match=r"`which`.*'dist'"):
        deploy.prepare(surface, "dist", p, p)  # pyright: ignore
    with pytest.raises(ValueError, match="`q`"):
        deploy.prepare(surface, "log", p, p[:, :2])
    with pytest.raises(ValueError, match="at least one query"):
        deploy.prepare(surface, "exp", p[:0], p[:0])


def test_missing_onnx_is_named(program, monkeypatch, tmp_path):
    find = importlib.util.find_spec
    monkeypatch.setattr(deploy, "find_spec", lambda name: None if name == "onnx" else find(name))
    with pytest.raises(ModuleNotFoundError, match=r"ONNX needs onnx; .*extra `deploy`"):
        deploy.export_onnx(program, tmp_path / "map.onnx")
    assert not list(tmp_path.iterdir())
