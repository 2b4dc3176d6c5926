"""Whatever a command line is given, and whatever the system refuses: one line and exit 2."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import TextIO

import pytest

from postproc import cli, report
from postproc.__main__ import COMMANDS
from postproc.commands.plot import FIGURES
from postproc.figures.theories import add_models
from postproc.tests.commands import call
from postproc.tests.runs import BARE, leave_out, results_of

READERS = [["report"], *(["plot", name] for name in ("numris", "comp05", "app2", "scene"))]
ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(name, ["--help"]) == 0
    assert f"python -m postproc {name} [-h]" in " ".join(capsys.readouterr().out.split())


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a folder of things that are no whole results file."""
    folder = tmp_path_factory.mktemp("files")
    content = bytearray(results_of(folder / "whole.h5").read_bytes())
    content[len(content) // 2] ^= 4
    (folder / "flipped").write_bytes(content)
    (folder / "cut").write_bytes(content[:3000])
    (folder / "empty").write_bytes(b"")
    (folder / "text").write_text("hello\n")
    (folder / "bytes").write_bytes(bytes(range(256)))
    (folder / "folder").mkdir()
    os.mkfifo(folder / "pipe")
    return folder


@pytest.mark.parametrize(
    "name", ["flipped", "cut", "empty", "text", "bytes", "folder", "pipe", "/dev/zero"]
)
@pytest.mark.parametrize("reader", READERS)
def test_no_whole_file(
    files: Path, reader: list[str], name: str, tmp_path: Path,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    command, *words = reader
    more = ["--verify"] if name == "flipped" else []
    assert call(command, [*words, *more, str(files / name)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "written"), [(["plot", "scene"], "run_scene.png"), (["report"], "run.html")]
)
@pytest.mark.parametrize(
    "before",
    [b"", b"! mine, not written by battery-postproc\n", b"\x89PNG mine", b"<!DOCTYPE html>mine",
     b"\x89PNG after one written by battery-postproc", b"%PDF written by battery-postproc",
     b"GIF89a written by battery-postproc", b"....ftypisom written by battery-postproc",
     b'<!DOCTYPE html><p content="written by battery-postproc">',
     b"Software\0written by battery-postproc",
     b'name="generator" content="written by battery-postproc'],
)  # fmt: skip
def test_no_file_of_someone_else_is_replaced(
    files: Path, tmp_path: Path, words: list[str], written: str, before: bytes,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Results (b"") are not, nor a picture or page that quotes the mark; its own are."""
    monkeypatch.chdir(tmp_path)
    Path("run.h5").write_bytes((files / "whole.h5").read_bytes())
    there = before or Path("run.h5").read_bytes()
    Path(written).write_bytes(there)
    assert call(words[0], [*words[1:], "run.h5"]) == 2
    assert "and is not replaced" in capsys.readouterr().err
    assert Path(written).read_bytes() == there
    Path(written).unlink()
    assert [call(words[0], [*words[1:], "run.h5"]) for _ in range(2)] == [0, 0]


def test_a_protected_file_and_one_of_another_kind_are_not_replaced(
    files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    report(files / "whole.h5", "mine.html")
    page = Path("mine.html").read_bytes()
    for kind in ("png", "nml"):
        with pytest.raises(cli.InputError, match=f"is no {kind} file written by battery-postproc"):
            cli.file_to_write(Path("mine.html"), kind)
    # The superuser may write to any file.
    monkeypatch.setattr(cli.os, "access", lambda path, _: not str(path).endswith("mine.html"))
    with pytest.raises(cli.InputError, match="is write-protected, and is not replaced"):
        report(files / "whole.h5", "mine.html")
    assert Path("mine.html").read_bytes() == page


SHORT = {"run": {"duration": 30.0, "transient_duration": 0.0}}
ODD: dict[str, dict[str, dict[str, object]]] = {
    "one": {"particles": {"number": 1}, "scan": {"threshold": 1, "replicas": 1}},
    "two": {"particles": {"number": 2}, "scan": {"threshold": 0}},
    "always": {"scan": {"threshold": 20}},
    "closed": {"table": {"channel2_width": 0.0}},
    "urn": {"table": {"shape": "urn"}},
    "polygon": {
        "table": {"urn_shape": "polygon", "urn_sides": 6},
        "particles": {"number": 300, "urn1_fraction": 1.0},
        "run": {"duration": 300.0, "transient_duration": 100.0},
        "scan": {"threshold": 4},
    },
    "scatterers": {"table": {"channel2_width": 0.3, "scatterers": [0.0, 0.0, 0.05]}},
    "map": {"scan": {"threshold": [1, 2], "channel2_width": [0.01, 0.05]}},
    "all": {"particles": {"number": 1}},
    "bare": {"output": BARE},
}
WINDOW = "--theory=window"  # of the theories of a figure's own choice one takes seconds
QUICK = [(["plot", "scene"], "one"), (["plot", "comp01"], "one"), (["table"], "map")]
QUICK += [(["plot", WINDOW, "lifetimes"], "map")]
SLOW = [["report"], ["table"], *(["plot", name] for name in FIGURES)]


@pytest.fixture(scope="module")
def odd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a folder of results that are legal and unusual."""
    folder = tmp_path_factory.mktemp("odd")
    for name, given in ODD.items():
        groups = {"particles": {"number": 20}, **SHORT, **given}
        results_of(folder / f"{name}.h5", **groups)
    for name, tasks in (("failed", [(0, 0)]), ("all_failed", [(0, 0), (0, 1)])):
        leave_out(results_of(folder / f"{name}.h5", particles={"number": 20}, **SHORT), *tasks)
    return folder


def assert_answered(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Hold that it ends well, or says in one line why it does not."""
    capsys.readouterr()
    code, said = call(words[0], words[1:]), capsys.readouterr().err
    assert code in (0, 2), words
    assert code == 0 or said.count("\n") == 1, (words, said)


@pytest.mark.usefixtures("unwritten")
@pytest.mark.parametrize(
    ("reader", "names"),
    [*QUICK, *(pytest.param(one, "*", marks=pytest.mark.full) for one in SLOW)],
    ids=lambda one: " ".join(one) if isinstance(one, list) else one,
)
def test_unusual_results_have_an_answer(
    odd: Path, tmp_path: Path, reader: list[str], names: str, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    for file in sorted(odd.glob(f"{names}.h5")):
        assert_answered([*reader, str(file)], capsys)


@pytest.mark.usefixtures("unwritten")
@pytest.mark.parametrize(
    ("words", "said"),
    [
        *((f"{name} map.h5 --snapshot 1", f"--snapshot is for figure scene, not {name}")
          for name in FIGURES if name != "scene"),
        ("circuit --snapshot 1", "--snapshot is for figure scene, not circuit"),
        ("urn --theory window", "figure urn needs at least one file of results"),
        ("scene map.h5 --point 1 --theory window", "figure scene has no place for a theory"),
        ("phase_diagram map.h5 --point 1", "a map needs two keys other than the start"),
        ("curves map.h5 --point 4", "point 4 is not one of 0 to 3"),
        ("curves closed.h5", "no point has a mean of 'polarised_current'"),
        ("characteristic all.h5", "no point has a finite U: chi is 1, or not a mean"),
        ("characteristic closed.h5", "no point has a mean of 'polarised_current'"),
    ],
)  # fmt: skip
def test_what_a_figure_cannot_show_is_refused_in_one_line(
    odd: Path, words: str, said: str, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(odd)
    assert call("plot", [*words.split(), WINDOW]) == 2
    told = capsys.readouterr().err
    assert (told.count("\n"), said in told) == (1, True), told


@pytest.mark.parametrize(
    ("words", "names"),
    [
        ("a.h5 b.h5 --theory window renewal", "window renewal"),
        ("--theory window renewal a.h5 b.h5", "window renewal"),
        ("a.h5 --theory renewal,window b.h5", "renewal window"),
        ("--theory=window,renewal a.h5 --theory direction b.h5", "window renewal direction"),
        ("--theory a.h5 b.h5", "invalid choice: 'a.h5'"),
        ("a.h5 b.h5 --theory window,widow", "invalid choice: 'widow'"),
        ("a.h5 b.h5 --theory --output .", "expected at least one argument"),
    ],
)
def test_values_of_an_option_end_where_files_begin(
    words: str, names: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options = cli.parser("report", None)
    options.add_argument("files", nargs="+")
    add_models(options)
    cli.add_output(options)
    try:
        given = options.parse_args(words.split())
        assert (given.files, given.theory) == (["a.h5", "b.h5"], names.split())
    except SystemExit:
        assert names in capsys.readouterr().err


@pytest.mark.parametrize("number", [errno.EEXIST, errno.EPERM])
def test_a_file_is_written_again_where_a_rename_replaces_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    rename = os.replace

    def replace(old: Path, new: Path) -> None:
        if Path(new).exists():
            raise OSError(number, os.strerror(number))
        rename(old, new)

    monkeypatch.setattr(os, "replace", replace)
    for text in ("first", "second"):
        with cli.replaced(tmp_path / "a") as file:
            file.write_text(text)
        assert (tmp_path / "a").read_text() == text
    calls = []

    def fail(old: Path, new: Path) -> None:
        calls.append(new)
        if len(calls) == 1:
            raise OSError(number, os.strerror(number))
        if len(calls) == 3:  # what was there is aside
            raise OSError(errno.EIO, "fails")
        rename(old, new)

    monkeypatch.setattr(os, "replace", fail)
    with (
        pytest.raises(cli.InputError, match="fails"),
        cli.replaced(tmp_path / "a") as file,
    ):
        file.write_text("lost")
    assert (tmp_path / "a").read_text() == "second"
    assert len(list(tmp_path.iterdir())) == 1


def test_names_of_files_behind_two_dashes_may_begin_with_one() -> None:
    options = cli.parser("report", None)
    options.add_argument("files", nargs="+")
    add_models(options)
    given = options.parse_args(["--theory", "window", "--", "-a.h5", "b.h5"])
    assert (given.files, given.theory) == (["./-a.h5", "b.h5"], ["window"])


@pytest.mark.parametrize(
    "command",
    [
        ["theory", "--theory", "window"],
        ["theory", "--theory", "renewal"],
        ["lifetimes"],
        *(
            pytest.param(["advise", "--quantity", one], marks=pytest.mark.full)
            for one in ("chi", "polarised_current", "transition")
        ),
    ],
    ids=" ".join,
)
def test_unusual_circuits_have_an_answer(
    command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    circuits = ["1 1", "1 0", "2 0", "2 5", "100 2", "100 200", "100 2 --channel2-width 0"]
    for circuit in circuits:
        number, threshold, *rest = circuit.split()
        assert_answered([*command, "--number", number, "--threshold", threshold, *rest], capsys)


def test_a_key_is_an_option_only_where_its_value_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert call("theory", ["--number", "0", "--threshold", "-1"]) == 2
    said = capsys.readouterr().err
    assert "--number = 0; allowed: a whole number from 1 to 200000000; --threshold = -1" in said


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("words", [["--number=100", "--threshold=3"], ["--help"]])
def test_output_on_a_full_device(words: list[str]) -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        ended = theory_to(full, words)
    assert (ended.returncode, ended.stderr) == (2, "error: No space left on device\n")


@pytest.mark.parametrize(
    ("words", "name"),
    [(["plot", "flows"], "whole_flows.png"), (["report"], "whole.html"),
     (["film", "--gif"], "whole_film.gif")],
)  # fmt: skip
def test_a_file_that_cannot_be_written_whole_leaves_what_was_there(
    files: Path, words: list[str], name: str, tmp_path: Path
) -> None:
    """A disk that is full in between is one line; nothing that is cut stays."""
    command = [sys.executable, "-m", "postproc", *words, str(files / "whole.h5")]
    command += ["--output", str(tmp_path)]
    first = subprocess.run(command, cwd=ROOT, capture_output=True, check=False, timeout=120)
    assert first.returncode == 0, first.stderr
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    most = len(before[name]) - 1
    ended = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=120,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (most, most)),
    )  # fmt: skip
    assert ended.returncode == 2
    assert ended.stderr.splitlines()[-1].endswith(f"{name}: File too large")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("words", [["--number=100", "--threshold=3"], ["--help"]])
def test_a_reader_that_has_enough_is_no_error(words: list[str]) -> None:
    """As of `| head`: nothing is said, and the exit is that of a program that SIGPIPE ended."""
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w", encoding="utf-8") as pipe:
        ended = theory_to(pipe, words)
    assert (ended.returncode, ended.stderr) == (141, "")


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_with_a_closed_stream_a_command_says_nothing_there(closed: str) -> None:
    words = f'exec "$0" -m postproc theory --number=100 --threshold=3 --theory=window {closed}'
    ended = subprocess.run(["sh", "-c", words, sys.executable], cwd=ROOT, capture_output=True,
                           text=True, check=False, timeout=120)  # fmt: skip
    assert (ended.returncode, ended.stderr) == (0, "")
    assert bool(ended.stdout) == (">&-" not in closed.split())


def theory_to(output: TextIO, words: list[str]) -> subprocess.CompletedProcess[str]:
    """Run the command `theory` with its output to a file."""
    return subprocess.run(
        [sys.executable, "-m", "postproc", "theory", *words], cwd=ROOT, stdout=output,
        stderr=subprocess.PIPE, text=True, check=False, timeout=120,
    )  # fmt: skip


def test_names_of_files_may_have_any_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also in the page that has the name as its title, and where the terminal has none of them."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.h5").write_bytes(results_of(tmp_path / "b.h5").read_bytes())
    name = os.fsdecode(b"\xff\xe9.h5")
    (tmp_path / "a.h5").rename(name)
    for words in (["report", name], ["plot", "flows", name]):
        ended = subprocess.run(
            [sys.executable, "-m", "postproc", *words], capture_output=True, check=False,
            env={**os.environ, "PYTHONIOENCODING": "ascii:strict", "PYTHONPATH": str(ROOT)},
        )  # fmt: skip
        assert (ended.returncode, ended.stderr) == (0, b"")


def test_a_file_by_a_circle_of_links_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    results_of(tmp_path / "a.h5")
    (tmp_path / "a.html").symlink_to("other.html")
    (tmp_path / "other.html").symlink_to("a.html")
    assert call("report", ["a.h5"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_dash_of_a_word_processor_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("theory", ["\u2013number", "100", "--threshold", "2"]) == 2
    assert "\u2013number: begins with another dash, U+2013, than -" in capsys.readouterr().err


def test_who_is_interrupted_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    def main(_: list[str] | None) -> int:
        raise KeyboardInterrupt

    assert cli.run(main) == cli.EXIT_INTERRUPTED
    assert capsys.readouterr().err == ""


def test_a_pipe_is_written_to() -> None:
    """By the name of standard output, under which a pipe has no place among files."""
    code = (
        "from postproc import cli\n"
        "with cli.replaced(cli.path_of('/dev/stdout', 'file')) as it: it.write_text('yes')"
    )
    ended = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert ended.stdout == "yes"


def test_what_cannot_be_a_file_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for name in ("file/one.nml", "n" * 300):
        with (
            pytest.raises(cli.InputError, match="cannot write"),
            cli.replaced(cli.file_to_write(tmp_path / name, "nml")) as half,
        ):
            half.write_text("no")


def test_a_tilde_is_the_home_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/someone")
    assert cli.path_of("~/runs/map.h5", "file") == Path("/home/someone/runs/map.h5")
    assert cli.path_of("~map.h5", "file") == Path("~map.h5")
