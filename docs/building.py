"""What mkdocs.yml asks for at build time: measured numbers, pictures, names of the reference.

In a page, on a line of its own,

    <!-- README NAME -->          the README's block NAME
    <!-- results PATTERN -->      benchmarks/results/PATTERN, Markdown
    <!-- against METHOD -->       benchmarks/results/tables.json: riemlayer beside that method
    <!-- api MODULE -->           the docstrings of all that MODULE exports

and pictures of benchmarks/results are at results/NAME.png. Numbers stand nowhere twice.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import griffe
from mkdocs.structure.files import File

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
COLUMNS = (("angle", "E_angle (degrees)", 1), ("log_end", "Log end", 4), ("exp", "E_Exp", 4))


def on_files(files: Any, config: Any) -> Any:
    """Puts the benchmarks' pictures into the site."""
    for path in sorted(RESULTS.glob("*.png")):
        files.append(File.generated(config, f"results/{path.name}", abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Fills the comments in; unknown names stop the build."""
    return filled(markdown)


def filled(markdown: str) -> str:
    """A page's text with what its comments name."""
    return re.sub(r"^<!-- (\S+) (\S+) -->$", lambda m: PARTS[m[1]](m[2]), markdown, flags=re.M)


def readme(name: str) -> str:
    """The README's block between `<!-- NAME -->` and `<!-- end NAME -->`."""
    text = (ROOT / "README.md").read_text("utf-8")
    block = re.search(rf"<!-- {name} -->\n(.*?)<!-- end {name} -->", text, re.S)
    if block is None:
        raise ValueError(f"README.md must hold a block {name!r}, found none")
    return block[1]


def results(pattern: str) -> str:
    """Markdown files of the benchmarks, their headings, but the title, two levels down."""
    paths = sorted(RESULTS.glob(pattern))
    if not paths:
        raise ValueError(f"benchmarks/results must hold {pattern}, found none")
    texts = [re.sub(r"\A# .*\n", "", path.read_text("utf-8")) for path in paths]
    return re.sub(r"^#", "###", "\n\n".join(texts), flags=re.M)


def against(method: str) -> str:
    """Mean errors of riemlayer and of another method, a group a row; the smaller ones are bold."""
    methods = json.loads((RESULTS / "tables.json").read_text("utf-8"))["methods"]
    ours, theirs = methods["base"]["groups"], methods[method]["groups"]
    shared = [g for g in ours if ours[g].get("r0.5") and theirs.get(g, {}).get("r0.5")]
    columns = [column for column in COLUMNS if column[0] in theirs[shared[0]]["r0.5"]]
    names = [f"{title}, {who}" for _, title, _ in columns for who in ("riemlayer", method)]
    lines = [["shapes", *names], ["---"] * (1 + len(names))]
    for group in shared:
        cells = []
        for key, _, digits in columns:
            pair = [groups[group]["r0.5"][key] for groups in (ours, theirs)]
            shown = [f"{x:.{digits}f}" for x in pair]
            best = shown[pair.index(min(pair))]
            cells += [f"**{x}**" if x == best else x for x in shown]
        lines.append([group, *cells])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def api(module: str) -> str:
    """Directives of mkdocstrings for all names in the `__all__` of a package, where they live."""
    source = ROOT.joinpath(*module.split("."), "__init__.py").read_text("utf-8")
    homes: dict[str, str] = {}
    exported: list[str] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module:
            homes |= {name.asname or name.name: node.module for name in node.names}
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            exported = ast.literal_eval(node.value)
    directives = (f"::: {homes[name]}.{name}" for name in exported)
    return "\n\n".join([f"To be imported from `{module}`.", *directives])


PARTS: dict[str, Callable[[str], str]] = {
    "README": readme,
    "results": results,
    "against": against,
    "api": api,
}


class ReadableDocstrings(griffe.Extension):
    """Puts the house's docstrings into the words of griffe's parser and of Markdown."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Called for every object that is loaded."""
        if obj.docstring is not None:
            obj.docstring.value = readable(obj.docstring.value)


def readable(docstring: str) -> str:
    """Examples in fences, one name a line, and sections of one line as plain text."""
    text = re.sub(r"(?m)^Example:\n((?: {4}.*\n?|\n)+)", _dedented, inspect.cleandoc(docstring))
    text = re.sub(r"^( *)>>> (?:.*\n?)(?:^(?!\s*$).*\n?)*", _fenced, text, flags=re.M)
    text = re.sub(r"^(Shapes|Args, Raises): (?=\S)", r"**\1** ", text, flags=re.M)
    return re.sub(r"(?ms)^(Args|Raises):\n(.*?)(?=^\S|\Z)", _one_name_a_line, text)


def _dedented(match: re.Match[str]) -> str:
    return textwrap.dedent(match[1])


def _fenced(match: re.Match[str]) -> str:
    indent = match[1]
    return f"{indent}```pycon\n{match[0].rstrip()}\n{indent}```\n"


def _one_name_a_line(match: re.Match[str]) -> str:
    entries = re.split(r"(?m)^(?=    \S)", match[2])
    lines = []
    for entry in entries:
        names, colon, rest = entry.partition(":")
        several = names.split(",") if colon and re.fullmatch(r" {4}[\w, ]+", names) else [names]
        lines += [
            f"    {name.strip()}{colon}{rest.rstrip()}\n" if colon else name for name in several
        ]
    return f"{match[1]}:\n" + "".join(lines) + "\n"
