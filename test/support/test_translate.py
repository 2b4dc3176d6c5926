"""Tests of the translator of the tests, and of the stand-in for pFUnit that runs them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SUPPORT = Path(__file__).resolve().parent
sys.path.insert(0, str(SUPPORT))
from translate import (  # noqa: E402
    LONGEST_NAME,
    TranslationError,
    driver,
    split_arguments,
    translate,
)

from postproc.launcher import LAUNCHER  # noqa: E402

SERIAL_SOURCES = ("exceptions", "assert_numbers", "funit")
STRICT = (
    "-O1 -g -std=f2018 -Wall -Wextra -Werror -Werror=implicit-interface -fcheck=all "
    "-finit-real=snan -ffpe-trap=invalid,zero,overflow"
)


def module(body: str, library: str = "funit", name: str = "test_sample") -> str:
    """Give a test module with these procedures."""
    return (
        f"module {name}\n  use {library}\n  implicit none (type, external)\ncontains\n{body}\n"
        f"end module {name}\n"
    )


def plain_test(name: str, *statements: str) -> str:
    """Give one test without MPI."""
    inner = "\n".join(f"    {statement}" for statement in statements)
    return f"  @test\n  subroutine {name}()\n{inner}\n  end subroutine {name}"


def mpi_test(name: str, npes: str, *statements: str) -> str:
    """Give one test with MPI."""
    inner = "\n".join(f"    {statement}" for statement in statements)
    return (
        f"  @test(npes={npes})\n  subroutine {name}(this)\n"
        f"    class(MpiTestMethod), intent(inout) :: this\n{inner}\n  end subroutine {name}"
    )


def line_of(text: str, wanted: str) -> int:
    """Give the number of the first line with these words."""
    return next(n for n, line in enumerate(text.splitlines(), start=1) if wanted in line)


@pytest.fixture(scope="session")
def libraries(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compile the stand-in once, with and without MPI, in the strictest way."""
    folder = tmp_path_factory.mktemp("standin")
    for name in (*SERIAL_SOURCES, "pfunit"):
        compiler = compiler_of(parallel=True)
        subprocess.run(
            [compiler, *STRICT.split(), "-c", str(SUPPORT / f"{name}.f90")], cwd=folder, check=True
        )
    return folder


def compiler_of(*, parallel: bool) -> str:
    """Name the compiler, or skip the test where there is none."""
    name = "mpifort" if parallel else "gfortran"
    if not shutil.which(name):
        pytest.skip(f"there is no {name}")
    return name


def run(
    text: str, libraries: Path, folder: Path, processes: int = 0
) -> subprocess.CompletedProcess[str]:
    """Translate, compile and run one test module; output and errors come back as one text."""
    fortran, suite = translate(text, "test_sample.pf")
    (folder / "test_sample.f90").write_text(fortran)
    (folder / "driver.f90").write_text(
        driver("run_tests", [suite.module], parallel=bool(processes))
    )
    objects = [str(libraries / f"{name}.o") for name in SERIAL_SOURCES]
    if processes:
        objects.append(str(libraries / "pfunit.o"))
    compiler = [compiler_of(parallel=True), *STRICT.split(), f"-I{libraries}", "-o", "run_tests"]
    subprocess.run([*compiler, "test_sample.f90", "driver.f90", *objects], cwd=folder, check=True)
    command = [str(folder / "run_tests")]
    if processes:
        command = ["mpirun", "-n", str(processes), *command]
    environment = {**os.environ, **LAUNCHER}
    return subprocess.run(
        command,
        env=environment,
        text=True,
        check=False,
        timeout=60,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )


def test_assert_knows_its_line() -> None:
    text = module(plain_test("one", "", "! a comment", "@assertTrue(.true.)"))
    fortran, _ = translate(text, "test_sample.pf")
    number = line_of(text, "@assertTrue")
    assert f"location=SourceLocation('test_sample.pf', {number}))" in fortran


def test_lines_after_an_assert_keep_their_numbers() -> None:
    text = module(plain_test("one", "@assertTrue(.true.)", "call next()"))
    fortran, _ = translate(text, "test_sample.pf")
    lines = fortran.splitlines()
    mark = lines[lines.index("    call next()") - 1]
    assert mark == f'# {line_of(text, "call next()")} "test_sample.pf"'


def test_ordinary_lines_pass_unchanged() -> None:
    continued = ["integer :: n", "n = 1 + &", "  2 + &", "", "  ! between", "  3", "print *, '@'"]
    text = module(plain_test("one", *continued))
    fortran, _ = translate(text, "test_sample.pf")
    for statement in continued:
        assert statement in fortran


def test_directive_in_a_comment_is_a_comment() -> None:
    text = module(plain_test("one", "! @assertTrue(.false.)"))
    fortran, suite = translate(text, "test_sample.pf")
    assert "call" not in fortran.split("end module")[0]
    assert len(suite.tests) == 1


def test_each_number_of_processes_is_a_test() -> None:
    fortran, suite = translate(module(mpi_test("one", "[1, 2]"), "pfunit"), "test_sample.pf")
    assert suite.tests[0].processes == [1, 2]
    assert suite.most_processes == 2
    assert fortran.count("suite%addTest(MpiTestMethod('one'") == 2


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        (plain_test("one", "@assertEqual(1, &", "  1)"), "one line"),
        (plain_test("one", "@assertEqual(1, 1) ! why"), "without a comment"),
        (plain_test("one", "if (.true.) @assertEqual(1, 1)"), "line of its own"),
        (plain_test("one", "@assertEqual(1)"), "too few"),
        (plain_test("one", "@assertEven(2)"), "unknown assert"),
        (plain_test("x" * (LONGEST_NAME + 1)), "longer than"),
        ("  @test\n  function one()\n", "comes a subroutine"),
        ("  @test(type=two)\n  subroutine one()\n  end subroutine one", "nothing else"),
        ("  @test(npes=[1])\n  subroutine one()\n  end subroutine one", "if, and only if"),
        ("  @tets\n  subroutine one()\n  end subroutine one", "unknown directive"),
        ("  @test\n", "comes a subroutine"),
    ],
)
def test_what_pfunit_would_not_take_is_refused(body: str, problem: str) -> None:
    with pytest.raises(TranslationError, match=problem) as caught:
        translate(module(body), "test_sample.pf")
    assert str(caught.value).startswith("test_sample.pf:")


def test_module_is_named_like_its_file() -> None:
    with pytest.raises(TranslationError, match="different names"):
        translate(module(plain_test("one"), name="test_other"), "test_sample.pf")


def test_arguments_split_only_between_brackets() -> None:
    assert split_arguments("f(a, b), [1, 2], 'x, y'") == ["f(a, b)", " [1, 2]", " 'x, y'"]
    assert split_arguments("") == []


def test_passing_tests_exit_0(libraries: Path, tmp_path: Path) -> None:
    text = module(
        plain_test(
            "one",
            "real :: numbers(2)",
            "numbers = [1.0, 2.0]",
            "@assertEqual([1.0, 2.5], numbers, tolerance=0.5)",
            "@assertEqual('a', ' a ')",
            "@assertLessThan(1, 2)",
            "@assertLessThan(1.0d0, 2.0d0)",
            "@assertFalse(.false.)",
        )
    )
    done = run(text, libraries, tmp_path)
    assert done.returncode == 0, done.stdout
    assert "Tests run: 1, Failures: 0" in done.stdout


@pytest.mark.parametrize(
    "assertion",
    [
        "@assertEqual(1.0, 1.5, tolerance=0.25)",
        "@assertEqual(1, 2)",
        "@assertEqual([1, 2], [1, 3])",
        "@assertEqual([1, 2], [1])",
        "@assertEqual('a', 'b')",
        "@assertTrue(.false.)",
        "@assertLessThan(2, 2)",
        "@assertLessThan(2.0, 2.0)",
    ],
)
def test_failing_assert_fails_the_program(assertion: str, libraries: Path, tmp_path: Path) -> None:
    text = module(plain_test("one", assertion, "error stop 'went on'"))
    done = run(text, libraries, tmp_path)
    assert done.returncode == 2, done.stdout
    assert f"[test_sample.pf:{line_of(text, '@assert')}]" in done.stdout
    assert "went on" not in done.stdout


@pytest.mark.parametrize(
    "assertion", ["@assertEqual(nan, nan, tolerance=1.0)", "@assertLessThan(nan, 1.0)"]
)
def test_nan_equals_nothing_and_is_not_less(
    assertion: str, libraries: Path, tmp_path: Path
) -> None:
    text = module(plain_test("one", "real :: nan", "nan = transfer(2143289344, nan)", assertion))
    done = run(text, libraries, tmp_path)
    assert done.returncode == 2, done.stdout
    assert f"[test_sample.pf:{line_of(text, '@assert')}]" in done.stdout


def test_processes_of_a_test_are_its_own(libraries: Path, tmp_path: Path) -> None:
    text = module(
        mpi_test(
            "sizes", "[1, 2]", "@assertLessThan(this%getProcessRank(), this%getNumProcesses())"
        ),
        "pfunit",
    )
    done = run(text, libraries, tmp_path, processes=2)
    assert done.returncode == 0, done.stdout
    assert "<test_sample_suite.sizes[npes=1]>" in done.stdout
    assert "Tests run: 2, Failures: 0" in done.stdout


def test_failure_of_any_process_is_reported_once(libraries: Path, tmp_path: Path) -> None:
    text = module(
        mpi_test("both", "[2]", "@assertEqual(1, this%getNumProcesses())")
        + "\n"
        + mpi_test("second", "[2]", "@assertEqual(0, this%getProcessRank())"),
        "pfunit",
    )
    done = run(text, libraries, tmp_path, processes=2)
    assert done.returncode == 2, done.stdout
    assert done.stdout.count("[test_sample.pf:") == 2
    assert "(PE=0,1)" in done.stdout
    assert "(PE=1)" in done.stdout
