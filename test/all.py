"""Run every test of the project: lint, the Fortran tests in both builds, the Python tests.

Each part prints what it prints; the last line of all is `N passed, M failed`. A linter that
complains counts as one failed test, and so does a part that breaks before it can count.
`make test` is the way to call this: it knows the compiler's switches.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
from postproc.launcher import SHARED_CORES  # noqa: E402

# A folder that may be deleted.
STUDIES = ["studies"] if (ROOT / "studies").is_dir() else []
TOOLS = ROOT / "build/venv/bin"
ENVIRONMENT = {
    **os.environ,
    **SHARED_CORES,
    "OPENBLAS_NUM_THREADS": "1",
}
# Many tests wait for a program that they have started, so two share a core.
WORKERS = str(min(16, 2 * (os.cpu_count() or 1)))


@dataclass
class Part:
    """One part of the tests: its name, its command, and whether it is a linter."""

    name: str
    command: list[str]
    lint: bool = False


def newest_flang() -> str:
    """Name the flang with the highest number that is installed; nothing where there is none.

    fpm takes `flang-22` for another compiler of that name; the new one is also `flang-new-22`. One
    that has the first name alone is not passed over: its part of the tests fails.
    """
    places = [path for folder in os.get_exec_path() for path in Path(folder).glob("flang-*")]
    numbers = [path.name.rpartition("-")[2] for path in places
               if re.fullmatch(r"flang(-new)?-\d+", path.name)]  # fmt: skip
    return f"flang-new-{max(numbers, key=int)}" if numbers else ""


def parts(arguments: argparse.Namespace) -> list[Part]:
    """List the parts in the order in which they run."""
    fortran = [sys.executable, "test/run", "--flavour"]
    debug = [*fortran, "debug", f"--flags={arguments.debug}", f"--ldflags={arguments.debug_link}"]
    # The suites with the optimised library take half as long again, most of it in the
    # linker. What users run is tested by the Python tests in any case.
    release = [
        f"--library={arguments.built}",
        f"--library-flags={arguments.release}",
        f"--library-ldflags={arguments.release_link}",
    ]
    ruff = str(TOOLS / "ruff")
    sources = ["--config", "postproc/ruff.toml", "postproc", "test", "docs", *STUDIES]
    # A file goes to one worker, so that what its tests share is made once.
    python = [sys.executable, "-m", "pytest", "-q", "-n", WORKERS, "--dist", "loadfile"]
    if not arguments.full:
        python += ["-m", "not full"]
    flang = newest_flang() if arguments.full else ""
    second = (
        [
            Part(
                f"Fortran, physics with {flang}",
                [*fortran, "release", "--physics", "--compiler", flang],
            )
        ]
        if flang
        else []
    )
    if arguments.full and not flang:
        print("no flang is installed: its part of the tests is left out")
    folders = ("src", "app", "test", "docs", *STUDIES)
    folders = [name for name in folders if any((ROOT / name).rglob("*.[fF]90"))]
    return [
        Part(
            "style of the Fortran sources",
            [str(TOOLS / "fortitude"), "check", "--output-format", "concise", *folders],
            lint=True,
        ),
        Part("style of the Python sources", [ruff, "check", *sources], lint=True),
        Part("format of the Python sources", [ruff, "format", "--check", *sources], lint=True),
        Part("types of what users import", [str(TOOLS / "mypy"), "--no-error-summary"], lint=True),
        Part(
            "Fortran, debug build with traps, then the library that make has built",
            [*debug, *release],
        )
        if arguments.full
        else Part("Fortran, debug build with traps", debug),
        *second,
        Part("Python", [*python, "postproc", "test", *STUDIES]),
    ]


def run(part: Part) -> tuple[int, int]:
    """Run one part, show what it prints, and give how many tests passed and failed."""
    print(f"\n== {part.name}", flush=True)
    begin = time.monotonic()
    process = subprocess.Popen(
        part.command,
        cwd=ROOT,
        env=ENVIRONMENT,
        text=True,
        errors="replace",
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    last = ""
    for line in process.stdout or ():
        print(line, end="", flush=True)
        last = line if line.strip() else last
    code = process.wait()
    print(f"{part.name}: {time.monotonic() - begin:.0f} s")
    if part.lint:
        return (0, 1) if code else (1, 0)
    passed, failed = (count(word, last) for word in ("passed", "failed"))
    failed += count("errors?", last)
    if code and not failed:
        print(f"{part.name}: exit code {code}")
        failed = 1
    if not code and not passed:
        print(f"{part.name}: no test ran")
        failed = 1
    return passed, failed


def count(word: str, line: str) -> int:
    """Read the number before a word; 0 if the word is not there."""
    match = re.search(rf"(\d+) {word}\b", line)
    return int(match.group(1)) if match else 0


def main() -> int:
    """Run all parts; give 1 if anything failed."""
    # nohup ignores it, and so would all programs that the tests start.
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--release", required=True, help="switches of the release build")
    parser.add_argument("--debug", required=True, help="switches of the debug build")
    parser.add_argument("--full", action="store_true", help="those too that take long")
    parser.add_argument("--built", required=True, help="where the release build is: lib, include")
    parser.add_argument("--release-link", default="", help="switches of its linker")
    parser.add_argument("--debug-link", default="", help="switches of its linker")
    counts = [run(part) for part in parts(parser.parse_args())]
    passed, failed = (sum(column) for column in zip(*counts, strict=True))
    print(f"\n{passed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
