"""The README's tables are what the benchmarks' files say."""

from pathlib import Path

import pytest

from benchmarks.readme import BLOCKS, filled

README = (Path(__file__).parents[1] / "README.md").read_text("utf-8")


@pytest.mark.parametrize("name", BLOCKS)
def test_every_table_stands_in_the_readme(name):
    table = BLOCKS[name]()
    assert len(table.splitlines()) > 3
    assert table in README


def test_empty_and_stale_blocks_are_filled():
    for old in ("", "stale\n"):
        text = "".join(f"<!-- {n} -->\n{old}<!-- end {n} -->\n" for n in BLOCKS)
        assert all(make() in filled(text) for make in BLOCKS.values())


def test_a_missing_block_raises():
    with pytest.raises(ValueError, match="one block"):
        filled("no blocks")


def test_tables_equal_the_files():
    assert filled(README) == README
