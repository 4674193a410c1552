"""`info` and `bench`."""

import json
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
import torch

import riemlayer

CARDS = Path(riemlayer.__file__).parent / "weights"


def test_info_tells_the_card_the_versions_and_the_shape(well, shapes, ball):
    facts = well("info", shapes / "ball.ply", "--json").facts
    card = json.loads((CARDS / "base.json").read_text())
    assert facts["card"]["parameters"] == card["training"]["parameters"]
    assert facts["card"]["licence"] == card["licence"]
    assert facts["versions"]["torch"] == torch.__version__
    assert facts["extras"]["viz"] == []
    shape = facts["shape"]
    assert (shape["kind"], shape["points"], shape["faces"]) == ("mesh", 642, 1280)
    assert shape["longest_side"] == pytest.approx(10) and shape["low"][0] == pytest.approx(95)
    assert shape["trained_radius"] == pytest.approx(2.5)
    assert len(ball.vertices) == 642
    text = well("info", shapes / "ball.ply").stdout
    assert "riemlayer: " in text and "ball.ply" in text and card["licence"] in text


def test_info_names_what_an_extra_lacks(well, monkeypatch):
    version = metadata.version

    def without(name):
        if name == "pyvista":
            raise metadata.PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(metadata, "version", without)
    assert 'viz: lacks pyvista: pip install "riemlayer[viz]"' in well("info").stdout


@pytest.mark.parametrize("shape", [None, "cloud.npz"])
def test_bench_times_encode_log_and_exp(well, shapes, tiny, shape):
    given = [] if shape is None else [shapes / shape]
    words = ["bench", *given, "--points", 500, "--repeats", 2, "--weights", tiny, "--json"]
    facts = well(*words, "--threads", 1).facts
    assert len(facts["milliseconds"]) == 3 and min(facts["milliseconds"].values()) > 0
    assert facts["points"] == (600 if shape else 500)
    assert np.isfinite(list(facts["milliseconds"].values())).all()
