"""fpm without make: a clean checkout builds, runs and installs, and others can build on it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import h5py
import pytest
from support.program import ALONE, ROOT, namelist
from support.program import run as run_program

SECTION = re.compile(r"^@(\w+)\noptions (\w+) (.*)\n((?:options .*\n)*)", re.MULTILINE)
WITHOUT_MAKE = {name: value for name, value in ALONE.items() if not name.startswith("FPM_")}


def sections() -> dict[str, tuple[str, str, str]]:
    """Return subcommand, its first switches, and the others, of each section of fpm.rsp."""
    text = (ROOT / "fpm.rsp").read_text(encoding="utf-8")
    return {name: rest for name, *rest in SECTION.findall(text)}


def test_release_run_and_install_have_the_same_switches() -> None:
    found = sections()
    assert {name: words[0] for name, words in found.items()} == {
        "release": "build", "debug": "build", "run": "run", "install": "install"}  # fmt: skip
    assert found["release"][2] == found["run"][2] == found["install"][2]
    common = "--compiler mpifort --archiver gcc-ar"
    assert all(words[1].endswith(common) for words in found.values())


def test_switches_stand_in_one_place() -> None:
    for name in ("fpm.rsp", "Makefile"):
        text = (ROOT / name).read_text(encoding="utf-8")
        assert not re.search(r"-O[0-3g]\b|-fwrapv|-std=", text), name
    for name, words in sections().items():
        flavour = "debug" if name == "debug" else "release"
        for what in ("compile", "link"):
            assert f"`packaging/switches {what} {flavour}`" in words[2]


def test_all_say_the_same_version() -> None:
    places = {
        "fpm.toml": r'^version = "(.*)"',
        "src/fpm.toml": r'^version = "(.*)"',
        "src/base/build_information.f90": r"program_version = '(.*)'",
        "postproc/__init__.py": r'^__version__ = "(.*)"',
        "CITATION.cff": r"^version: (.*)",
    }
    found = {
        place: re.search(pattern, (ROOT / place).read_text(encoding="utf-8"), re.MULTILINE)[1]
        for place, pattern in places.items()
    }
    assert len(set(found.values())) == 1, found
    assert run_program("--version", folder=ROOT).stdout.split()[1] == found["fpm.toml"]


def clean_checkout(folder: Path) -> Path:
    """Copy what fpm needs, and nothing that make made."""
    for name in ("src", "app", "packaging", "docs/examples"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("build"))
    for name in ("fpm.toml", "fpm.rsp"):
        shutil.copy(ROOT / name, folder)
    return folder


def fpm(*arguments: str, folder: Path) -> str:
    """Call fpm as one does by hand; return what it, and what it runs, prints."""
    own = ROOT / "build/venv/bin/fpm"
    done = subprocess.run(
        [str(own) if own.exists() else "fpm", *arguments], cwd=folder, env=WITHOUT_MAKE, text=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:]
    return done.stdout


@pytest.mark.parametrize(
    "file", ["src/ensemble/communicator.f90", "src/store/hdf5_file.f90", "src/interop/gsl.c"]
)
def test_without_switches_the_compiler_shows_what_to_type(file: str) -> None:
    """`fpm build` alone ends at the first of these: it knows no MPI, HDF5 and GSL of modules."""
    done = subprocess.run(
        ["gfortran", "-fsyntax-only", *(["-nostdinc"] if file.endswith(".c") else []), file],
        cwd=ROOT, env=WITHOUT_MAKE, check=False, text=True, capture_output=True,
    )  # fmt: skip
    assert 'type "fpm @release"' in done.stderr


@pytest.mark.full
def test_a_clean_checkout_builds_runs_and_installs(tmp_path: Path) -> None:
    place = clean_checkout(tmp_path / "battery")
    fpm("@release", "build", folder=place)
    (place / "in.nml").write_text(
        namelist(particles={"number": 50}, gate={"threshold": 5}, run={"collisions": 1000}),
        encoding="utf-8")  # fmt: skip
    assert "1 of 1 tasks are complete" in fpm("@run", "--", "in.nml", folder=place)
    with h5py.File(place / "battery.h5") as file:
        assert file.attrs["git_commit"] == "unknown"
    fpm("@install", "--prefix", str(tmp_path / "there"), folder=place)
    done = subprocess.run(
        [tmp_path / "there/bin/battery", "--version"],
        env=ALONE, check=True, text=True, capture_output=True,
    )  # fmt: skip
    assert " (commit unknown)\n" in done.stdout


@pytest.mark.full
def test_the_debug_build_needs_no_make(tmp_path: Path) -> None:
    place = clean_checkout(tmp_path / "battery")
    fpm("@debug", folder=place)
    assert any(os.access(path, os.X_OK) for path in place.glob("build/mpifort_*/app/battery"))


@pytest.mark.full
def test_the_example_measures_what_the_program_counts(tmp_path: Path) -> None:
    place = clean_checkout(tmp_path / "battery") / "docs/examples/reversal_times"
    said = fpm("run", "--profile", "release", folder=place)
    count, mean = re.search(
        r"(\d+) times between reversals.*\nmean ([\d.]+), their spread [\d.]+", said
    ).groups()
    (tmp_path / "in.nml").write_text(
        namelist(
            particles={"number": 1000}, gate={"threshold": 7},
            run={"duration": 2000.0}, scan={"replicas": 4},
        ),
        encoding="utf-8")  # fmt: skip
    assert run_program("in.nml", folder=tmp_path).returncode == 0
    with h5py.File(tmp_path / "battery.h5") as file:
        counted = file["reversals"][0]
    assert counted.min() * 0.9 < int(count) < counted.max() * 1.1
    assert 0.5 < int(count) * float(mean) / 2000.0 < 2.0  # one gate nearly always, or both
