"""The program as a whole: help, --json, --debug, exit codes, what it imports, bars."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from urllib.request import urlopen

import pytest

from riemlayer.cli import progress as bars
from riemlayer.cli.app import app
from riemlayer.cli.errors import UserError, judge

COMMANDS = [x.name or x.callback.__name__ for x in app.registered_commands]  # pyright: ignore
PROGRAM = Path(sys.executable).with_name("riemlayer")


def shell(*words: object) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "riemlayer", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True)


def plain(text: str) -> str:
    """Without colours and frames."""
    return " ".join(re.sub(r"\x1b\[[0-9;]*m|[│╭╰─╮╯]", " ", text).split())


def test_every_subcommand_of_the_issue_is_there():
    wanted = (
        "exp log geodesic stitch decal mean view prepare pretrain finetune tables bench info export"
    )
    assert {*wanted.split()} <= {*COMMANDS}


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example_and_the_common_flags(well, command):
    text = plain(well(command, "--help").stdout)
    assert f"For instance: riemlayer {command} " in text
    assert "--json" in text and "--debug" in text


def test_help_lists_all_and_no_argument_is_help(well):
    first, second = well("--help").stdout, well().stdout
    assert first == second
    assert all(command in first for command in COMMANDS)


def test_version(well):
    import riemlayer

    assert well("--version").stdout == f"riemlayer {riemlayer.__version__}\n"


def test_help_waits_for_no_torch_and_the_package_for_no_typer():
    code = (
        "import sys, riemlayer; assert 'typer' not in sys.modules\n"
        "import riemlayer.cli\n"
        "heavy = {'torch', 'trimesh', 'pyvista', 'lightning', 'lightning_modules', 'scipy'}\n"
        "print(sorted(heavy & {*sys.modules}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.stdout.strip(), done.stderr) == ("[]", "")


def test_exit_codes_of_the_installed_program(shapes, tiny, tmp_path):
    good = [PROGRAM, "log", shapes / "cloud.npz", "--source", "0", "--weights", tiny]
    done = subprocess.run([*good, "-o", tmp_path / "a.npz"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    done = shell("log", tmp_path / "none.ply", "--source", 0, "-o", tmp_path / "b.npz")
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.count("\n") == 1 and "none.ply" in done.stderr


def test_the_viewer_answers_until_it_is_interrupted(shapes, tiny):
    words = [PROGRAM, "view", shapes / "ball.ply", "--points", "300", "--weights", tiny]
    program = subprocess.Popen(
        [*words, "--no-browser", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # ignored in background
    )
    try:
        assert program.stdout is not None and program.stderr is not None
        url = json.loads(program.stdout.readline())["url"]
        page = urlopen(url).read().decode()
        assert "ball.ply" in page
        assert "drawings" in json.load(urlopen(f"{url}drawings?point=5"))
        program.send_signal(signal.SIGINT)
        assert program.wait(60) == 0
        assert program.stderr.read() == ""
    finally:
        program.kill()
        program.communicate()


# errors


def test_a_failure_of_ours_is_one_line_and_a_traceback_only_with_debug(run, monkeypatch, shapes):
    def broken(*_):
        raise RuntimeError("two\nlines")

    monkeypatch.setattr("riemlayer.cli.about.shape_facts", broken)
    quiet = run("info", shapes / "cloud.npz")
    loud = run("info", shapes / "cloud.npz", "--debug")
    assert quiet.code == loud.code == 1
    assert quiet.stderr.count("\n") == 1 and "RuntimeError: two lines" in quiet.stderr
    assert "Traceback" in loud.stderr and loud.stderr.endswith(quiet.stderr)


def test_errors_are_json_too(run, tmp_path):
    done = run("info", tmp_path / "none.ply", "--json")
    assert done.code == 2
    assert done.facts == {"error": done.stderr.removeprefix("riemlayer info: ").strip()} | {
        "exit_code": 2
    }


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (UserError("name: mend"), 2, "name: mend"),
        (ModuleNotFoundError("no", name="pyvista.core"), 2, 'pip install "riemlayer[viz]"'),
        (ModuleNotFoundError("no", name="scipy"), 2, 'pip install "riemlayer[data]"'),
        (ModuleNotFoundError("no", name="lightning.pytorch"), 2, 'pip install "riemlayer[cli]"'),
        (ModuleNotFoundError("no", name="elsewhere"), 1, "internal error"),
        (OSError(28, "No space left on device", "/disk/file"), 2, "/disk/file: No space left"),
        (ValueError("ours"), 1, "internal error, ValueError: ours"),
    ],
)
def test_whose_fault_an_error_is(error, code, words):
    judged, message = judge(error)
    assert judged == code and words in message and "\n" not in message


def test_what_an_extra_lacks_is_named(run, monkeypatch, shapes, tiny, tmp_path):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    out = tmp_path / "a.png"
    done = run("exp", shapes / "cloud.npz", "-s", 0, "-o", out, "--weights", tiny)
    assert done.code == 2 and 'pip install "riemlayer[viz]"' in done.stderr
    assert not list(tmp_path.iterdir())


def test_clouds_need_the_core_packages_alone(shapes, tiny, tmp_path):
    """`log`, `exp` and `info` of .npz and .xyz, without any package of an extra."""
    code = (
        "import sys\n"
        "from riemlayer.cli.errors import EXTRAS\n"
        "names = {x for extra in EXTRAS.values() for x in extra} - {'tqdm'}\n"
        "sys.modules.update(dict.fromkeys(names))\n"
        "from riemlayer.cli.app import app\n"
        "for words in sys.argv[1:]:\n"
        "    try: app(words.split())\n"
        "    except SystemExit as end: assert not end.code, words\n"
    )
    calls = [f"info {shapes}/cloud.xyz --weights {tiny}"]
    for name in ("cloud.npz", "cloud.xyz"):
        for command in ("log", "exp"):
            out = tmp_path / f"{command}-{name[-3:]}.npz"
            calls.append(f"{command} {shapes}/{name} --source 0 -o {out} --weights {tiny}")
    done = subprocess.run([sys.executable, "-c", code, *calls], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert len(list(tmp_path.iterdir())) == 4


def test_an_interrupted_write_leaves_nothing(run, monkeypatch, shapes, tiny, tmp_path):
    def stopped(path, arrays):
        Path(path).write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr("riemlayer.cli.output.write_npz", stopped)
    done = run("log", shapes / "cloud.npz", "-s", 0, "-o", tmp_path / "a.npz", "--weights", tiny)
    assert done.code == 130
    assert not list(tmp_path.iterdir())


# bars


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("stream", "delay", "drawn"),
    [(Terminal(), 0.0, True), (Terminal(), 60.0, False), (io.StringIO(), 0.0, False)],
)
def test_a_bar_is_for_terminals_and_for_what_takes_long(monkeypatch, stream, delay, drawn):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(bars, "DELAY", delay)
    with bars.progress():
        bars.stage("counting")
        seen = []
        for i in bars.track(range(3), "counting on"):
            seen.append(i)
            time.sleep(0.15 if drawn else 0)
    assert seen == [0, 1, 2]
    assert ("counting on" in stream.getvalue()) == drawn


def test_no_bar_where_a_command_has_its_own(monkeypatch):
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(bars, "DELAY", 0.0)
    with bars.progress(wanted=False):
        bars.stage("nothing")
        time.sleep(0.05)
    assert stream.getvalue() == ""


def test_the_terminal_s_width_does_not_break_the_help(run, monkeypatch):
    monkeypatch.setitem(os.environ, "COLUMNS", "40")
    assert run("log", "--help").code == 0
