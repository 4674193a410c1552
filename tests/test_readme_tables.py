"""The README's tables are what the benchmarks' files say."""

from pathlib import Path

from benchmarks.readme import BLOCKS, filled

README = (Path(__file__).parents[1] / "README.md").read_text("utf-8")


def test_every_block_is_there():
    assert [name for name in BLOCKS if f"<!-- {name} -->" not in README] == []


def test_tables_equal_the_files():
    assert filled(README) == README
