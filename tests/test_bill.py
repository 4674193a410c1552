"""The bill is what its rates say, and its command and that of the axes run."""

import json

import pytest

from benchmarks import axes, bill
from benchmarks.bill import row, table

SHAPES = [
    {"what": "embedding", "batch": 8, "ranks": 1, "shapes_per_second": 99.0},
    {"what": "embedding", "batch": 4, "ranks": 1, "shapes_per_second": 2.0},
    {"what": "embedding", "batch": 4, "ranks": 2, "shapes_per_second": 3.0},
]
SHAPES[1]["megabytes_a_shape"] = 8.0
FACTS = {"processor": "P", "cores": 2, "load_before": 7.5}


def test_hours_and_costs_can_be_done_in_the_head():
    """2 shapes a second, efficiency 3/4: a million take 10^6 / 2 / 3600 / 0.75 core hours."""
    found = row("embedding", SHAPES, cores=100, price=0.5)
    assert found["efficiency"] == 0.75
    million = found["bills"][1]
    assert million["shapes"] == 10**6
    assert million["core_hours"] == pytest.approx(10**6 / 5400)
    assert million["cluster_hours"] == pytest.approx(10**4 / 5400)
    assert million["cost"] == pytest.approx(10**6 / 10800)
    assert million["terabytes"] == pytest.approx(8e6 / 2**20)
    thousands, billions = (found["bills"][i].values() for i in (0, 2))
    for thousand, billion in zip(thousands, billions, strict=True):
        assert billion == pytest.approx(10**6 * thousand)


def test_work_that_was_not_measured_is_refused():
    with pytest.raises(ValueError, match="log on 1 and 2 ranks"):
        row("log", SHAPES, 1, 1.0)


def test_the_command_writes_what_the_page_shows(tmp_path, capsys):
    (tmp_path / "axes.json").write_text(json.dumps({"machine": FACTS, "shapes": SHAPES}))
    fit = {"fixed": 0.5, "point": 1e-3, "leaf": 1e-2}
    scaling = {"facts": {"threads": 2, "load_before": 1.15}, "fit": fit}
    scaling["one_cloud"] = [{"points": 1000, "leaves": 50}]
    (tmp_path / "scaling.json").write_text(json.dumps(scaling))
    bill.main(["--results", str(tmp_path), "--cores", "100", "--price", "0.5"])
    results = json.loads((tmp_path / "bill.json").read_text())
    text = (tmp_path / "bill.md").read_text()
    assert text.strip() == table(results) and text.strip() in capsys.readouterr().out
    assert "| embedding | 10^6 | 185 | 1.85 | 92.6 | 7.63 |" in text
    assert "| 1,000 | 0.500 | 1.000 | 0.500 | 2.000 |" in text and "load of 7.5" in text


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::Warning:lightning")
def test_the_axes_are_measured(tmp_path):
    axes.main(["--fast", "--weights", "preset:tiny", "--output", str(tmp_path)])
    found = json.loads((tmp_path / "axes.json").read_text())
    assert {x["what"] for x in found["shapes"]} == {*axes.ASKED, "training step"}
    assert all(x["shapes_per_second"] > 0 for x in found["shapes"])
    assert all(x["exp"] > 0 and x["log"] > 0 for x in found["queries"])
    assert "load_before" in found["machine"]
