"""Every test starts from the same seed and without a network."""

import os

os.environ["HF_HUB_OFFLINE"] = "1"
os.environ.setdefault("MPLBACKEND", "Agg")

import numpy as np
import pytest
import torch

LONGEST = (
    "test_examples.py",
    "test_laws.py",
    "test_docs.py",
    "test_why_not_project.py",
    "test_poor_input.py",
)
"""Files that take a minute or more: begun first, so that no core waits for one at the end."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.path.name not in LONGEST)  # the order is kept otherwise


@pytest.fixture(autouse=True)
def seed() -> None:
    """The same random numbers in every test, whatever ran before."""
    torch.manual_seed(0)
    np.random.seed(0)  # noqa: NPY002  (libraries still draw from it)
