"""What a run logs of its own cost."""

import csv
from importlib import util
from pathlib import Path

import psutil
import pytest
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger

from lightning_modules import Memory, Throughput

pytestmark = pytest.mark.filterwarnings("ignore::Warning:lightning")  # it talks of its own matters

spec = util.spec_from_file_location("ranks", Path(__file__).with_name("ranks.py"))
ranks = util.module_from_spec(spec)
spec.loader.exec_module(ranks)


def fit(folder, tmp_path, logger) -> None:
    given = {"logger": logger, "log_every_n_steps": 1, "gradient_clip_val": 1.0}
    ranks.fit(folder, tmp_path, 4, callbacks=(Throughput(window=2), Memory()), **given)


def test_rates_memory_and_gradient_norm_are_logged(folder, tmp_path):
    fit(folder, tmp_path, CSVLogger(tmp_path, ""))
    with (tmp_path / "version_0/metrics.csv").open() as file:
        rows = list(csv.DictReader(file))

    def column(name: str) -> list[float]:
        return [float(row[f"train/{name}"]) for row in rows if row[f"train/{name}"]]

    shapes, queries = column("device/samples_per_sec"), column("device/items_per_sec")
    assert len(shapes) >= 2 and all(x > 0 for x in shapes)
    for a, b in zip(shapes, queries, strict=True):
        assert b == pytest.approx(3 * 16 * a)  # sources times vectors of a shape
    assert all(x > 0 for x in column("gradient_norm"))
    now = psutil.Process().memory_info().rss / 2**20
    assert all(0.3 * now < x < 3 * now for x in column("memory_mb"))


def test_tensorboard_is_an_option(folder, tmp_path):
    pytest.importorskip("tensorboardX", reason="needs the extra `scale`")
    fit(folder, tmp_path, TensorBoardLogger(tmp_path, ""))
    assert [x for x in tmp_path.rglob("events.out.tfevents.*") if x.stat().st_size > 500]
