"""The deployment benchmark runs, and its tables say what was measured."""

import contextlib
import json

import pytest
import torch

from benchmarks import deploy as benchmark
from benchmarks.deploy import Precision, Timing, table
from riemlayer import deploy

FACTS = dict.fromkeys(("weights", "processor", "threads", "torch", "onnxruntime"), "?")
FACTS |= {"load_before": 0.5, "cores": 2, "shapes": 3}


def test_tables_divide_by_the_compiled_time_and_name_the_processor():
    timing = Timing("Log", 0.001, 0.006, 0.007, 0.012, 0.003, 20.0, 2e-7)
    half = Precision("bfloat16", (1e-3, 2e-3, 3e-3), (4e-3, 5e-3, 6e-3), 0.01, None)
    text = table([timing], [half], FACTS | {"bfloat16": False})
    assert "| Log | 1 ms | 6 ms | 3 ms | 2.00 | 20 s | 7 ms | 12 ms | 0.50 |" in text
    assert "| bfloat16 | 1.0e-03 | 2.0e-03 | 3.0e-03 | 4.0e-03 |" in text
    assert "within 2e-07 of eager" in text and "has no bfloat16 instructions" in text


class Eager(benchmark.Programs):
    """In the place of exported programs, which other tests try."""

    def __init__(self, field, which):
        self.decoder = deploy.Decoder(field, which)

    def runs(self, inputs):
        return dict.fromkeys(("exported", "onnx"), lambda: self.decoder(**inputs))


@pytest.mark.slow
def test_writes_json_and_markdown(tmp_path, monkeypatch, capsys):
    pytest.importorskip("manifold3d", reason="procedural shapes need the extra `data`")
    pytest.importorskip("onnxruntime", reason="needs the extra `deploy`")
    monkeypatch.setattr(benchmark, "Programs", Eager)
    threads = str(torch.get_num_threads())
    options = ["--fast", "--no-compile", "--weights", "preset:tiny", "--threads", threads]
    benchmark.main([*options, "--output", str(tmp_path)])
    results = json.loads((tmp_path / "deploy.json").read_text())
    assert (tmp_path / "deploy.md").read_text().strip() in capsys.readouterr().out
    assert all(row["eager"] > 0 and row["compiled"] is None for row in results["times"])
    errors = {row["what"]: row["exp"] + row["log"] for row in results["precision"]}
    single, bfloat, half = (errors[x] for x in errors if "encoding" not in x)
    assert not any(single)
    assert all(0 < b < a < 0.1 for a, b in zip(bfloat, half, strict=True))  # 8 bits against 11


def test_the_benchmark_stays_in_single_precision(monkeypatch):
    """Also where the processor has bfloat16."""
    monkeypatch.setattr("riemlayer.field._has_bfloat16", lambda device: True)
    field = benchmark.full_precision("preset:tiny")
    assert isinstance(field.half_precision(), contextlib.nullcontext)
