"""Every block of code in the documentation runs, page by page, in a folder of its own.

A page's Python blocks share one namespace, its calls of `riemlayer` the folder. Blocks with
`title="not run by the tests"` would train for long or need files of the reader's: Python in them is
compiled and its names from riemlayer are looked up, options of `riemlayer` are parsed. Options of
other programs of the project are looked for in their sources.
"""

from __future__ import annotations

import ast
import json
import re
import shlex
import tomllib
import warnings
from importlib import import_module, util
from pathlib import Path
from typing import NamedTuple

import pytest
import torch
import typer
from typer.testing import CliRunner

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
FENCE = re.compile(r"^( *)```(\w+)?([^\n]*)\n(.*?)^\1```", re.S | re.M)
LANGUAGES = ("python", "sh", "text", "json", "yaml")
MOST_NOT_RUN = 8
WIDEST = 94
"""Columns of a block of code that the site shows without scrolling."""


class Block(NamedTuple):
    """A fenced block of a page."""

    page: Path
    line: int
    language: str
    runs: bool
    code: str

    @property
    def where(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def blocks(page: Path) -> list[Block]:
    text, found = page.read_text("utf-8"), []
    for match in FENCE.finditer(text):
        indent, language, info, code = match.groups()
        line = text[: match.start(4)].count("\n") + 1
        code = re.sub(rf"^{indent}", "", code, flags=re.M)
        found.append(
            Block(page, line, language or "", 'title="not run by the tests"' not in info, code)
        )
    return found


ALL = [block for page in PAGES for block in blocks(page)]
CODE = [page for page in PAGES if any(b.language in ("python", "sh") for b in blocks(page))]


def name(page: Path) -> str:
    return str(page.relative_to(DOCS))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where a page runs; torch's seed and gradient mode are its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    with torch.random.fork_rng(), torch.enable_grad():
        torch.manual_seed(0)
        yield tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("page", CODE, ids=name)
def test_page_runs(page, folder, capsys):
    namespace: dict = {"__name__": "__main__"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # other libraries', at import
        warnings.filterwarnings("ignore", module="lightning")  # it talks of its own matters
        for block in blocks(page):
            if not block.runs:
                continue
            if block.language == "python":
                run_python(block, namespace)
            elif block.language == "sh":
                for words in commands(block):
                    if words[0] == "riemlayer":
                        run_riemlayer(block, words[1:])


def run_python(block: Block, namespace: dict) -> None:
    padded = "\n" * (block.line - 1) + block.code  # so that tracebacks name the page's lines
    exec(compile(padded, str(block.page), "exec"), namespace)


def run_riemlayer(block: Block, words: list[str]) -> None:
    from riemlayer.cli.app import app

    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, f"{block.where}: {shlex.join(words)}\n{done.output}\n{done.stderr}"


def commands(block: Block) -> list[list[str]]:
    """The words of each line of a shell block, comments left out."""
    code = block.code.replace("\\\n", " ")
    return [words for line in code.splitlines() if (words := shlex.split(line, comments=True))]


SHELL = [
    pytest.param(block, words, id=f"{name(block.page)}-{block.line}-{i}")
    for block in ALL
    if block.language == "sh"
    for i, words in enumerate(commands(block))
]


@pytest.mark.parametrize(("block", "words"), SHELL)
def test_options_of_commands_exist(block, words):
    while "=" in words[0]:
        words = words[1:]
    program, *rest = words
    if program == "riemlayer":
        parse_riemlayer(block, rest)
    elif program == "make":
        targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text("utf-8"), re.M)
        assert all(word in targets for word in rest if "=" not in word), block.where
    elif program == "python":
        source = source_of(rest)
        flags = [word.split("=")[0] for word in rest if word.startswith("--")]
        for flag in flags:
            known = f'"{flag}"' in source or re.match(
                r"--(trainer|model|data|config|ckpt_path)", flag
            )
            assert known, f"{block.where}: {flag} is no option of {' '.join(rest)}"
    elif program in ("bash", "sbatch"):
        assert [x for x in rest if (ROOT / x).is_file()], block.where
    elif program == "pip":
        extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
        for named in re.findall(r"\.\[([\w,]+)\]", " ".join(rest)):
            assert {*named.split(",")} <= {*extras["optional-dependencies"]}, block.where
    else:
        raise AssertionError(f"{block.where}: {program} is not looked at by this test")


def source_of(words: list[str]) -> str:
    """The source of the program that `python` is told to run."""
    if words[0] != "-m":
        return (ROOT / words[0]).read_text("utf-8")
    spec = util.find_spec(words[1])
    assert spec is not None, f"there is no module {words[1]}"
    if spec.submodule_search_locations:
        spec = util.find_spec(f"{words[1]}.__main__")
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).read_text("utf-8")


def parse_riemlayer(block: Block, words: list[str]) -> None:
    """Parses the options without running the subcommand."""
    from riemlayer.cli.app import app

    group = typer.main.get_command(app)
    if words[0].startswith("-"):
        return
    assert words[0] in group.commands, f"{block.where}: riemlayer has no subcommand {words[0]}"
    group.commands[words[0]].make_context(words[0], list(words[1:]))


STILL = [block for block in ALL if block.language == "python" and not block.runs]


@pytest.mark.parametrize("block", STILL, ids=lambda b: f"{name(b.page)}-{b.line}")
def test_what_is_not_run_compiles_and_its_imports_exist(block):
    for node in ast.walk(ast.parse(block.code, str(block.page))):
        if isinstance(node, ast.ImportFrom) and node.module:
            root = node.module.split(".")[0]
            if root in ("riemlayer", "lightning_modules"):
                module = import_module(node.module)
                missing = [x.name for x in node.names if not hasattr(module, x.name)]
                assert not missing, f"{block.where}: {node.module} has no {missing}"


def test_languages_and_titles_are_known():
    """A misspelt language or title would leave a block unlooked at."""
    assert not [b.where for b in ALL if b.language not in LANGUAGES]
    infos = [
        i[1] for page in PAGES for i in re.findall(r"^ *```(\w+)([^\n]*)$", page.read_text(), re.M)
    ]
    assert {*infos} <= {"", ' title="not run by the tests"'}


def test_few_blocks_are_not_run():
    python = [block for block in ALL if block.language == "python"]
    assert len(python) > 30
    assert len(STILL) <= MOST_NOT_RUN


def test_code_is_no_wider_than_the_page():
    wide = [(b.where, x) for b in ALL for x in b.code.splitlines() if len(x) > WIDEST]
    assert not wide


def test_files_that_the_pages_name_exist():
    """Paths in backquotes are those of the repository."""
    pattern = r"`((?:examples|benchmarks|riemlayer|lightning_modules|tests)/[\w./-]+)`"
    missing = [
        f"{name(page)}: {path}"
        for page in PAGES
        for path in re.findall(pattern, page.read_text("utf-8"))
        if not (ROOT / path).exists()
    ]
    assert not missing


@pytest.fixture(scope="module")
def building():
    """docs/building.py, which needs the extra docs."""
    pytest.importorskip("mkdocstrings_handlers.python")
    spec = util.spec_from_file_location("building", DOCS / "building.py")
    assert spec is not None and spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_comments_are_filled_in(building, page):
    assert not re.search(r"^<!-- \w+ \S+ -->$", building.filled(page.read_text("utf-8")), re.M)


@pytest.mark.parametrize("comment", ["README nothing", "results nothing.md", "against nothing"])
def test_comments_that_name_nothing_stop_the_build(building, comment):
    with pytest.raises((ValueError, KeyError)):
        building.filled(f"<!-- {comment} -->")


def test_a_rival_stands_beside_riemlayer_with_its_own_errors(building):
    methods = json.loads((ROOT / "benchmarks/results/tables.json").read_text("utf-8"))["methods"]
    rows = building.against("heat").splitlines()[2:]
    for row in rows:
        group, *cells = (cell.strip(" *") for cell in row.strip("|").split("|"))
        pairs = zip(cells[::2], cells[1::2], ("angle", "log_end"), strict=True)
        for ours, theirs, key in pairs:
            for shown, method in ((ours, "base"), (theirs, "heat")):
                exact = methods[method]["groups"][group]["r0.5"][key]
                assert float(shown) == pytest.approx(
                    exact, rel=0, abs=0.051 if key == "angle" else 6e-5
                )


def test_docstrings_become_what_the_parser_reads(building):
    text = building.readable(
        """One line.

        Args:
            p, v: (..., 3) points,
                and vectors.
            k: a number.

        Raises:
            TypeError, ValueError: nonsense.

        Shapes: x (N,) -> y (N,)

        >>> 1 + 1
        2
        """
    )
    assert "    p: (..., 3) points,\n        and vectors.\n    v: (..., 3) points," in text
    assert "    TypeError: nonsense.\n    ValueError: nonsense." in text
    assert "**Shapes** x" in text
    assert "```pycon\n>>> 1 + 1\n2\n```" in text


def test_every_page_is_in_the_navigation():
    text = (ROOT / "mkdocs.yml").read_text("utf-8")
    assert not [name(page) for page in PAGES if f": {name(page)}\n" not in text]
