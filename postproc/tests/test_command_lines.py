"""Whatever a command line is given, and whatever the system refuses: one line and exit 2."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from postproc.tests.commands import call
from postproc.tests.runs import results_of

READERS = [["currents"], ["scene"], ["report"], ["compare"], ["mixing"], ["renewal_fit", "--data"]]
READERS += [["figures", name] for name in ("numris", "comp05", "app2", "lifetimes")]
READERS += [["benchmarks", "compare", os.devnull]]
COMMANDS = ["theory", "lifetimes", "currents", "scene", "figures", "compare", "mixing", "film"]
COMMANDS += ["report", "accuracy", "benchmarks", "scaling", "scheduler", "renewal_fit"]
COMMANDS += ["shapes", "lorentz"]
ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(name, ["--help"]) == 0
    assert f"python -m postproc.{name} [-h]" in " ".join(capsys.readouterr().out.split())


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
    files: Path, reader: list[str], name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    command, *words = reader
    assert call(command, [*words, str(files / name)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("option", ["ranks", "tasks", "seconds", "service", "seed", "spread"])
@pytest.mark.parametrize("value", ["-1", "nan", "inf", "1e300", "99999999999999999999", "x"])
def test_numbers_without_sense(option: str, value: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("scheduler", ["--ranks=10", "--tasks=100", f"--{option}={value}"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("words", [["--number=100", "--threshold=3"], ["--help"]])
def test_output_on_a_full_device(words: list[str]) -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        ended = subprocess.run(
            [sys.executable, "-m", "postproc.theory", *words],
            cwd=ROOT,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=120,
        )
    assert (ended.returncode, ended.stderr) == (2, "error: No space left on device\n")
