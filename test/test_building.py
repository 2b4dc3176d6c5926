"""Where the build finds its libraries, and what it says of those that are missing."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from support.program import ENVIRONMENT, ROOT

if TYPE_CHECKING:
    from pathlib import Path

CHOICES = ("MPI", "MPIFC", "FC", "HDF5", "GSL", "OPENSSL", "MARCH", "FPM", "OMPI_FC")
#: What the tool itself calls; wrappers and pkg-config come from each test.
TOOLS = ("bash", "awk", "find", "sort", "sed", "grep", "paste", "mktemp", "rm", "python3", "env",
         "mpifort", "gfortran", "gcc", "cc", "as", "ld")  # fmt: skip


def hdf5(place: Path) -> Path:
    """Make a folder as that of an installed HDF5: empty files by the names that are looked for."""
    for name in ("include/hdf5.mod", "lib/libhdf5_fortran.so"):
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text("", encoding="utf-8")
    return place


def script(path: Path, text: str) -> None:
    """Write a program of the shell."""
    path.write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
    path.chmod(0o755)


@pytest.fixture
def tools(tmp_path: Path) -> Path:
    """Make a PATH without h5pfc, gsl-config, pkg-config, apt and sudo."""
    folder = tmp_path / "tools"
    folder.mkdir()
    for name in TOOLS:
        if place := shutil.which(name):
            (folder / name).symlink_to(place)
    return folder


def switches(tools: Path, *words: str, **said: object) -> subprocess.CompletedProcess[str]:
    """Ask for switches, with nothing but these tools and what is said."""
    environment = {name: value for name, value in ENVIRONMENT.items() if name not in CHOICES}
    environment |= {"PATH": str(tools)} | {name: str(value) for name, value in said.items()}
    return subprocess.run(
        [ROOT / "packaging/switches", *words], cwd=tools, env=environment, text=True,
        capture_output=True, check=False,
    )  # fmt: skip


def test_a_copied_checkout_has_commands_of_its_own(tmp_path: Path) -> None:
    """Commands of its virtual environment, and what that imports, are not those of the other."""
    other, commands = tmp_path / "other", tmp_path / "build/venv/bin"
    packages = tmp_path / "build/venv/lib/python3/site-packages"
    for folder in (commands, packages):
        folder.mkdir(parents=True)
    (commands / "python").symlink_to(sys.executable)
    script(commands / "tool", f"exec {other}/build/venv/bin/python")
    (packages / "battery.pth").write_text(f"{other}\n", encoding="utf-8")
    words = ["make", "-C", tmp_path, "-f", ROOT / "Makefile", "relocate"]
    subprocess.run(words, check=True, capture_output=True)
    assert (commands / "tool").read_text().endswith(f"exec {commands}/python\n")
    assert (packages / "battery.pth").read_text() == f"{tmp_path}\n"
    linked = tmp_path / "linked"
    (linked / "build").mkdir(parents=True)
    (linked / "build/venv").symlink_to(tmp_path / "build/venv")
    words[2] = linked
    subprocess.run(words, check=True, capture_output=True)
    assert (packages / "battery.pth").read_text() == f"{tmp_path}\n"


def test_the_user_comes_before_wrappers_and_those_before_pkg_config(
    tmp_path: Path, tools: Path
) -> None:
    said, wrapped, packed = (hdf5(tmp_path / name) for name in ("said", "wrapped", "packed"))
    assert "hdf5" not in switches(tools, "compile", "release").stdout
    script(
        tools / "pkg-config",
        f'case "$*" in *" hdf5") echo -I{packed}/include -L{packed}/lib;; *) exit 1;; esac',
    )
    assert f"-I{packed}/include" in switches(tools, "compile", "release").stdout
    # CMake's wrapper knows no -show, and its words are no switches; one without modules is no use.
    script(tools / "h5pfc", "echo dir is /nowhere; exit 1")
    assert f"-I{packed}/include" in switches(tools, "compile", "release").stdout
    script(tools / "h5fc", f"echo gfortran -I{wrapped}/include {wrapped}/lib/libhdf5_fortran.a -lz")
    assert f"-I{wrapped}/include" in switches(tools, "compile", "release").stdout
    link = switches(tools, "link", "release").stdout
    assert f"-L{wrapped}/lib -Wl,-rpath,{wrapped}/lib" in link
    link = switches(tools, "link", "release", HDF5=said, GSL=said).stdout
    assert f"-L{said}/lib -Wl,-rpath,{said}/lib" in link
    assert f"-I{said}/include" in switches(tools, "compile", "debug", HDF5=said).stdout
    assert switches(tools, "c", GSL=said).stdout == f"-I{said}/include\n"


def test_the_processor_is_said_in_one_place(tools: Path) -> None:
    assert " -march=native " in switches(tools, "compile", "release").stdout
    said = switches(tools, "compile", "release", MARCH="x86-64-v3").stdout
    assert " -march=x86-64-v3 " in said
    assert "native" not in said


def test_what_is_missing_is_named_with_what_to_type(tmp_path: Path, tools: Path) -> None:
    done = switches(tools, "missing", HDF5=hdf5(tmp_path / "empty"))
    assert done.returncode == 1
    lines = done.stdout.splitlines()
    assert lines[0] == "Missing, or older than this, or of another compiler:"
    assert "  HDF5 1.10 with Fortran modules by this compiler, shared libraries (HDF5=DIR)" in lines
    apt, dnf = (next(line for line in lines if who in line) for who in ("apt-get", "dnf"))
    assert "apt-get install" in apt
    assert "libhdf5-openmpi-dev" in apt
    assert "hdf5-openmpi-devel" in dnf
    assert "libhdf5-openmpi-dev" in switches(tools, "missing", "apt", HDF5=tmp_path).stdout.split()


def test_a_library_that_is_there_is_not_missing_because_mpi_is(tools: Path) -> None:
    (tools / "mpifort").unlink()
    said = switches(tools, "missing").stdout
    assert "mpi_f08" in said
    assert "libcrypto" not in said


def test_another_program_called_fpm_is_not_taken(tmp_path: Path) -> None:
    """One that writes its version in parts is; it was taken for none in half of the calls."""
    found = []
    for line in ("echo 1.15.1", "for word in 0.12 fpm of Fortran; do echo $word; sleep 0.01; done"):
        script(tmp_path / "fpm", line)
        path = f"{tmp_path}:{ENVIRONMENT['PATH']}"
        said = subprocess.run(["make", "-C", tmp_path, "-f", ROOT / "Makefile", "-pn", "help"],
                              env={**ENVIRONMENT, "PATH": path}, text=True, capture_output=True,
                              check=False).stdout  # fmt: skip
        found += re.findall("^fpm := (.*)", said, re.M)[-1:]
    assert found == [f"{tmp_path}/build/venv/bin/fpm", f"{tmp_path}/fpm"]


def test_what_does_not_work_is_forgotten(tmp_path: Path) -> None:
    for name in ("Makefile", "packaging/switches", "postproc/requirements.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    for name in ("src", "app"):
        (tmp_path / name).mkdir()
    script(tmp_path / "fpm", "echo 'Program: fpm(1)'")
    outer = ("FPM", "MAKEFLAGS", "MFLAGS")
    environment = {name: value for name, value in ENVIRONMENT.items() if name not in outer}

    def make(*said: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(["make", "libraries", *said], cwd=tmp_path, env=environment,
                              text=True, capture_output=True, check=False)  # fmt: skip

    assert not make(f"FPM={tmp_path}/fpm").returncode
    assert f"FPM ?= {tmp_path}/fpm" in (tmp_path / "build/choices").read_text(encoding="utf-8")
    for wrong in ("FPM=true", f"FPM={tmp_path}/no_fpm"):
        assert f"fpm 0.12: {wrong} is none" in make(wrong).stderr
        assert not make().returncode


@pytest.mark.full
def test_the_product_does_without_studies(tmp_path: Path) -> None:
    """In a copy without that folder the demo runs, pages are made, and tests are found and pass.

    Only those that read pages and the tree run: all of `make test` once more would double its time,
    and a test that imports or names a study fails as it is collected, or in `test_layers`.
    """
    place = tmp_path / "battery"
    left = shutil.ignore_patterns("build", "studies", ".git", "__pycache__")
    shutil.copytree(ROOT, place, ignore=left)
    shutil.copytree(ROOT / "build/stamps", place / "build/stamps")
    (place / "build/venv").symlink_to(ROOT / "build/venv")
    outside = {key: value for key, value in ENVIRONMENT.items() if not key.startswith("MAKE")}
    pytest_ = ["build/venv/bin/python", "-m", "pytest", "-q", "-m", "not full"]
    for command in (
        ["make", "demo"], ["make", "docs"], ["make", "lint"],
        [*pytest_, "--collect-only", "postproc", "test"],
        [*pytest_, "test/test_manual.py", "test/test_layers.py", "postproc/tests/test_models.py"],
    ):  # fmt: skip
        ended = subprocess.run(command, cwd=place, env=outside, text=True, check=False,
                               capture_output=True)  # fmt: skip
        assert ended.returncode == 0, f"{command}: {(ended.stdout + ended.stderr)[-4000:]}"
