"""The doors of an installed battery: one prefix, one command, one man page."""

from __future__ import annotations

import ast
import importlib
import os
import re
import shutil
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest
from support.program import ENVIRONMENT, PROGRAM, ROOT, make

from postproc import __main__ as command
from postproc.tests.commands import call as scripted

OUTSIDE = {name: value for name, value in ENVIRONMENT.items() if not name.startswith("BATTERY_")}


def call(*words: object, folder: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Run a command outside of any other make."""
    environment = {name: value for name, value in OUTSIDE.items() if not name.startswith("MAKE")}
    return subprocess.run(
        [str(word) for word in words], cwd=folder, env=environment, stdin=subprocess.DEVNULL,
        text=True, capture_output=True, check=False,
    )  # fmt: skip


def test_an_unwritable_prefix_is_one_message(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    done = call("make", "install", f"PREFIX={tmp_path}/file")
    said = [line for line in done.stderr.splitlines() if not line.startswith("make: ***")]
    assert said == [
        f"{tmp_path}/file/bin: cannot be written to; make install PREFIX=DIR takes another place"
    ]
    assert done.returncode != 0
    assert "Error 1" in done.stderr
    assert done.stdout == ""


def test_every_command_is_listed_and_can_be_called() -> None:
    without, starting = command.description().split("With the program")
    for name in command.COMMANDS:
        place = starting if name in command.STARTING else without
        assert re.search(rf"^  {name} +\S", place, re.MULTILINE)
        assert callable(importlib.import_module(f"postproc.commands.{name}").main)


def test_commands_and_package_work_from_every_folder(tmp_path: Path) -> None:
    """With the Python of the checkout; what is public stays so when each module is imported."""
    tools = ROOT / "build/venv/bin"
    options = ["--number", "1000", "--threshold", "7", "--theory", "window"]
    called = call(tools / "battery-postproc", "theory", *options, folder=tmp_path)
    assert '"mass_spread"' in called.stdout, called.stderr
    text = (
        "import importlib, pkgutil, postproc as p\n"
        "for one in pkgutil.walk_packages(p.__path__, 'postproc.'):\n"
        "    if '.tests' not in one.name: importlib.import_module(one.name)\n"
        "print(*(f'{n} {type(getattr(p, n)).__name__};' for n in dir(p)))"
    )
    listed = call(tools / "python", "-c", text, folder=tmp_path)
    assert "Circuit type;" in listed.stdout, listed.stderr
    modules = [one.split()[0] for one in listed.stdout.split(";") if one.endswith("module")]
    assert modules == ["plot"]
    old = call(tools / "python", "-m", "postproc.currents", "run.h5", folder=tmp_path)
    assert old.stderr == (
        "error: python -m postproc.currents is battery-postproc plot flows since version 0.4.0\n"
    )
    gone = call(tools / "python", "-m", "postproc.compare", folder=tmp_path)
    assert gone.stderr.endswith("No module named postproc.compare\n")


@cache
def imports(path: Path) -> list[str]:
    """Return the modules that a file may import: what it names, and each name of theirs."""
    names = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{one.name}" for one in node.names)]
    return names


def reached(module: str) -> set[str]:
    """Return the modules of postproc that one imports, directly or not; itself is one of them."""
    found, left = set(), [module]
    while left:
        name = left.pop()
        path = ROOT.joinpath(*name.split(".")).with_suffix(".py")
        if name in found or not path.is_file():
            continue
        found.add(name)
        left += imports(path)
    return found


def test_what_is_said_to_need_no_program_starts_none() -> None:
    for name in command.COMMANDS:
        starts = reached(f"postproc.commands.{name}") & {"postproc.running", "postproc.launcher"}
        if name in command.STARTING:
            assert "postproc.running" in starts, name
        else:
            assert not starts, name


def test_a_subcommand_does_what_the_script_does(capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--number", "1000", "--threshold", "7"]
    one = call(sys.executable, "-m", "postproc", "theory", *options)
    assert scripted("theory", options) == 0
    assert one.stdout == capsys.readouterr().out
    assert '"mass_spread"' in one.stdout


@pytest.mark.parametrize("words", [[], ["nosuch"]])
def test_a_wrong_word_is_one_line(words: list[str]) -> None:
    done = call(sys.executable, "-m", "postproc", *words)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout == ""


@pytest.mark.parametrize("words", [["theory", "--number", "x"], ["currents", "no.h5"]])
def test_a_wrong_word_of_a_subcommand_is_one_line(
    words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In this process, where its libraries are loaded already."""
    monkeypatch.setattr(sys, "argv", ["postproc", *words])
    with pytest.raises(SystemExit) as ended:
        raise SystemExit(command.run())
    told = capsys.readouterr()
    assert ended.value.code == 2
    assert len(told.err.splitlines()) == 1
    assert told.out == ""


def test_the_python_side_names_what_it_imports() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = [one for extra in project["optional-dependencies"].values() for one in extra]
    asked = {re.match(r"[\w-]+", one)[0] for one in project["dependencies"] + extras}
    pinned = (ROOT / "postproc/requirements.txt").read_text(encoding="utf-8")
    assert asked <= set(re.findall(r"^([\w-]+)==", pinned, re.MULTILINE))
    imported = set()
    for path in ROOT.glob("postproc/**/*.py"):
        if "tests" not in path.parts:
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Import):
                    imported |= {one.name.split(".")[0] for one in node.names}
                elif isinstance(node, ast.ImportFrom):
                    imported.add(node.module.split(".")[0])
    foreign = {one for one in imported if one not in sys.stdlib_module_names}
    foreign -= {"postproc", "contourpy"}  # matplotlib needs contourpy
    assert {one.replace("_", "-") for one in foreign} <= asked


def test_the_man_page_has_every_key_and_option(tmp_path: Path) -> None:
    page = call(sys.executable, "docs/man_page.py", PROGRAM).stdout
    told = call(PROGRAM, "--help").stdout
    plain = page.replace("\\-", "-").replace("\\&", "").replace("\\e", "\\")
    shown = [line for line in told.splitlines() if line.startswith(("  ", "&"))]
    assert len(shown) > 50
    for line in shown:
        assert line in plain.splitlines()
    if shutil.which("groff"):
        (tmp_path / "battery.1").write_text(page, encoding="utf-8")
        done = call("groff", "-man", "-Tascii", "-ww", "-z", tmp_path / "battery.1")
        assert (done.returncode, done.stderr) == (0, "")


PROGRAM_OF_TWO = {
    "main.f90": """program main
  use cell, only: in_urn
  use battery_kinds, only: wp
  implicit none (type, external)

  print '(l1)', in_urn(-1.4_wp)
end program main
""",
    "cell.f90": """module cell
  use battery_kinds, only: wp
  use battery_table, only: table_type, new_table, shape_circuit, chamber_at, outside
  implicit none (type, external)
contains
  logical function in_urn(x)
    real(wp), intent(in) :: x
    type(table_type) :: table

    table = new_table(shape_circuit, 1.0_wp, 0.3_wp, 1.0_wp, 0.01_wp, 1.0_wp)
    in_urn = chamber_at(table, x, 0.0_wp, 0.0_wp) /= outside
  end function in_urn
end module cell
""",
}


def test_the_library_is_installed_without_building_and_others_link_with_it(
    tmp_path: Path,
) -> None:
    prefix = tmp_path / "there"
    make("build")
    before = PROGRAM.stat().st_mtime_ns
    make("install", f"PREFIX={prefix}", "POSTPROC=0")
    assert PROGRAM.stat().st_mtime_ns == before
    assert (prefix / "bin/battery").read_bytes() == PROGRAM.read_bytes()
    assert not (prefix / "bin/battery-postproc").exists()
    for name, text in PROGRAM_OF_TWO.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    words = subprocess.run(
        ["pkg-config", "--cflags", "--libs", "battery"], check=True, text=True,
        capture_output=True, env=OUTSIDE | {"PKG_CONFIG_PATH": str(prefix / "lib/pkgconfig")},
    ).stdout.split()  # fmt: skip
    built = call("mpifort", "cell.f90", "main.f90", *words, "-o", "two", folder=tmp_path)
    assert built.returncode == 0, built.stderr
    assert call(tmp_path / "two").stdout == "T\n"
    version = call(PROGRAM, "--version").stdout.split()[1]
    module = (prefix / "share/modulefiles/battery" / version).read_text(encoding="utf-8")
    assert module.startswith("#%Module")
    assert f"prepend-path PATH {prefix}/bin\n" in module


@pytest.mark.full
def test_an_installed_battery_needs_no_checkout(tmp_path: Path) -> None:
    prefix = tmp_path / "a prefix"
    make("install", f"PREFIX={prefix}")
    assert call(prefix / "bin/battery", "--version", folder=tmp_path).returncode == 0
    assert ".TH BATTERY 1" in (prefix / "share/man/man1/battery.1").read_text(encoding="utf-8")
    postproc = prefix / "bin/battery-postproc"
    assert "mass_spread" in call(
        postproc, "theory", "--number", "1000", "--threshold", "7", folder=tmp_path
    ).stdout  # fmt: skip
    assert "usage: battery-postproc theory" in call(
        postproc, "theory", "--help", folder=tmp_path
    ).stdout  # fmt: skip
    ran = call(
        prefix / "lib/battery/bin/python", "-c",
        "import postproc\n"
        "given = {'particles': {'number': 50}, 'gate': {'threshold': 5}, 'run': {'duration': 5}}\n"
        "print(postproc.open_results(postproc.run(given, quiet=True)).sizes['replica'])",
        folder=tmp_path,
    )  # fmt: skip
    assert (ran.stdout, ran.returncode) == ("1\n", 0), ran.stderr
    drawn = call(postproc, "report", "battery.h5", folder=tmp_path)
    assert drawn.returncode == 0, drawn.stderr
    assert sorted(path.name for path in (prefix / "bin").iterdir()) == [
        "battery", "battery-postproc",
    ]  # fmt: skip
    assert not list((prefix / "lib/battery/bin").glob("renewal_*"))
    assert os.access(postproc, os.X_OK)
