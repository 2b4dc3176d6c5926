#!/usr/bin/env python3
"""Turn pFUnit tests (.pf) into Fortran, the way pFUnit's own preprocessor does.

Only the part of pFUnit that the project's tests use is understood; anything else is refused with
the file and the line, so that a test that passes here is one that pFUnit takes too.
"""

from __future__ import annotations

import argparse
import re
import sys
from dataclasses import dataclass, field
from pathlib import Path

#: Asserts by lower-case name, and how many arguments they need at least.
ASSERTS = {
    "asserttrue": 1,
    "assertfalse": 1,
    "assertequal": 2,
    "assertlessthan": 2,
}

#: pFUnit builds longer names from these.
LONGEST_NAME = 44

MODULE = re.compile(r"\s*module\s+(\w+)\s*$", re.IGNORECASE)
SUBROUTINE = re.compile(r"\s*subroutine\s+(\w+)\s*(\([\w\s,]*\))?\s*(!.*)?$", re.IGNORECASE)
DIRECTIVE = re.compile(r"(\s*)@(\w+)\s*(.*?)\s*$")
NPES = re.compile(r"\(\s*npes\s*=\s*\[\s*(\d+(?:\s*,\s*\d+)*)\s*\]\s*\)$", re.IGNORECASE)
LITERAL = re.compile(r"'[^']*'|\"[^\"]*\"")


class TranslationError(Exception):
    """Something in a test file that is not understood."""

    def __init__(self, file: str, line: int, problem: str) -> None:
        super().__init__(f"{file}:{line}: {problem}")


@dataclass
class Test:
    """One test procedure and how it is to be run."""

    name: str
    processes: list[int]


@dataclass
class Suite:
    """The tests of one module."""

    module: str
    tests: list[Test] = field(default_factory=list)

    @property
    def parallel(self) -> bool:
        """Whether some test wants MPI."""
        return any(test.processes for test in self.tests)

    @property
    def most_processes(self) -> int:
        """How many processes the widest test wants; 0 without MPI."""
        return max((most for test in self.tests for most in test.processes), default=0)


class Translator:
    """Translation of one file, line by line.

    Parameters
    ----------
    text : str
        The test module as written.
    file : str
        Name of the file, for messages and for the locations of asserts.
    """

    def __init__(self, text: str, file: str) -> None:
        self.file = file
        self.lines = text.splitlines()
        self.suite = Suite(module="")
        self.output: list[str] = []
        self.number = 0
        self.waiting = False  # whether a @test waits for its subroutine
        self.processes: list[int] = []

    def refuse(self, problem: str) -> TranslationError:
        """Give the error for the line at hand."""
        return TranslationError(self.file, self.number, problem)

    def translate(self) -> str:
        """Translate the whole file.

        Returns
        -------
        str
            The module, followed by the function that collects its tests.
        """
        self.mark(1)
        continued = False
        for number, line in enumerate(self.lines, start=1):
            self.number = number
            code = LITERAL.sub("''", line).split("!")[0].rstrip()
            if not code.strip():
                self.output.append(line)  # a comment or a blank line ends no statement
                continue
            directive = DIRECTIVE.match(line)
            if directive and not continued:
                self.apply(directive)
            elif "@" in code:
                raise self.refuse("a directive stands on a line of its own")
            else:
                self.look(line)
                self.output.append(line)
            continued = code.endswith("&")
        self.finish()
        self.output += self.collector()
        return "\n".join(self.output) + "\n"

    def mark(self, number: int) -> None:
        """Tell the compiler which line of the test file comes next."""
        self.output.append(f'# {number} "{self.file}"')

    def apply(self, directive: re.Match[str]) -> None:
        """Act on a line that begins with a directive."""
        indent, word, rest = directive.groups()
        name = word.lower()
        if name.startswith("assert"):
            self.write_assert(indent, word, rest)
            return
        if name != "test":
            raise self.refuse(f"unknown directive @{word}")
        if self.waiting:
            raise self.refuse("@test still waits for its subroutine")
        self.waiting = True
        self.processes = self.read_processes(rest)
        self.output.append(f"{indent}! @{word}{rest}")

    def read_processes(self, rest: str) -> list[int]:
        """Read the argument of @test: nothing, or npes=[...]."""
        if not rest or re.fullmatch(r"\(\s*\)", rest):
            return []
        match = NPES.match(rest)
        if not match:
            raise self.refuse("@test takes npes=[...] and nothing else")
        return [int(item) for item in match.group(1).split(",")]

    def write_assert(self, indent: str, word: str, rest: str) -> None:
        """Write an assert as a call that knows where it stands."""
        if word.lower() not in ASSERTS:
            raise self.refuse(f"unknown assert @{word}")
        bare = LITERAL.sub("''", rest)
        if bare.endswith("&") or bare.count("(") > bare.count(")"):
            raise self.refuse(f"@{word} does not fit on one line: name its arguments first")
        if not (rest.startswith("(") and rest.endswith(")")) or "!" in bare:
            raise self.refuse(f"@{word}(...) ends its line, without a comment")
        arguments = rest[1:-1].strip()
        if len(split_arguments(arguments)) < ASSERTS[word.lower()]:
            raise self.refuse(f"@{word} has too few arguments")
        call = f"{indent}call {word}({arguments}{', ' if arguments else ''}&"
        location = f"{indent}  & location=SourceLocation('{self.file}', {self.number}))"
        self.mark(self.number)
        self.output += [call, location, f"{indent}if (anyExceptions()) return"]
        self.mark(self.number + 1)

    def look(self, line: str) -> None:
        """Note the names that an ordinary line declares."""
        module = MODULE.match(line)
        if module and not self.suite.module:
            self.suite.module = module.group(1)
            if self.suite.module.lower() != Path(self.file).stem.lower():
                raise self.refuse("module and file have different names")
        if not self.waiting:
            return
        subroutine = SUBROUTINE.match(line)
        if not subroutine:
            raise self.refuse("after @test comes a subroutine, on one line")
        name = subroutine.group(1)
        if len(name) > LONGEST_NAME:
            raise self.refuse(f"{name} is longer than {LONGEST_NAME} characters")
        takes_test = bool((subroutine.group(2) or "()").strip("() "))
        if takes_test != bool(self.processes):
            raise self.refuse("a test has an argument if, and only if, it has npes")
        self.suite.tests.append(Test(name, self.processes))
        self.waiting = False

    def finish(self) -> None:
        """Check what only the end of the file can tell."""
        if self.waiting:
            raise self.refuse("@test waits for a subroutine")
        if not self.suite.module:
            raise self.refuse("there is no module")

    def collector(self) -> list[str]:
        """Write the function that collects the tests of the module."""
        suite = self.suite
        name = f"{suite.module}_suite"
        lines = [
            "",
            f"function {name}() result(suite)",
            "  use funit, only: TestSuite, TestMethod",
            f"  use {suite.module}",  # as pFUnit does: MpiTestMethod comes from here
            "  implicit none (type, external)",
            "  type(TestSuite) :: suite",
            "",
            f"  suite = TestSuite('{name}')",
        ]
        for test in suite.tests:
            for wanted in test.processes or [0]:
                kind, place = ("MpiTestMethod", f", {wanted}") if wanted else ("TestMethod", "")
                lines.append(f"  call suite%addTest({kind}('{test.name}', &")
                lines.append(f"    {test.name}{place}))")
        return [*lines, f"end function {name}"]


def split_arguments(arguments: str) -> list[str]:
    """Split at the commas that are in no bracket and in no text."""
    bare = LITERAL.sub(lambda match: "x" * len(match.group()), arguments)
    pieces, depth, start = [], 0, 0
    for position, character in enumerate(bare):
        depth += (character in "([") - (character in ")]")
        if character == "," and depth == 0:
            pieces.append(arguments[start:position])
            start = position + 1
    last = arguments[start:]
    return [*pieces, last] if last.strip() or pieces else []


def translate(text: str, file: str) -> tuple[str, Suite]:
    """Translate one test module.

    Parameters
    ----------
    text : str
        The module as written.
    file : str
        Name of its file.

    Returns
    -------
    tuple of str and Suite
        The Fortran text, and what it tests.
    """
    translator = Translator(text, file)
    return translator.translate(), translator.suite


def driver(name: str, modules: list[str], *, parallel: bool) -> str:
    """Write a program that runs the suites of some modules.

    It runs one suite if the environment variable ``TEST_SUITE`` names its module, and all if not.
    The same text serves pFUnit and the stand-in.

    Parameters
    ----------
    name : str
        Name of the program.
    modules : list of str
        Modules with tests.
    parallel : bool
        Whether it runs on MPI.

    Returns
    -------
    str
        The Fortran text.
    """
    library = "pfunit" if parallel else "funit"
    lines = [
        "!> Runs tests; written by the translator of the tests.",
        f"program {name}",
        "  use, intrinsic :: ieee_exceptions, only: ieee_all, ieee_status_type, ieee_get_status, &",
        "    ieee_set_status, ieee_set_halting_mode",
        f"  use {library}, only: TestSuite, initialize, run, finalize, stub",
        *(f"  use {module}, only:" for module in modules),
        "  implicit none (type, external)",
        "",
        "  interface",
    ]
    for module in modules:
        lines += [
            f"    function {module}_suite() result(suite)",
            "      import :: TestSuite",
            "      implicit none (type, external)",
            "      type(TestSuite) :: suite",
            f"    end function {module}_suite",
        ]
    lines += [
        "  end interface",
        "",
        "  logical :: passed",
        "  type(ieee_status_type) :: status",
        "",
        "  ! Open MPI 5 makes a NaN on purpose while it starts.",
        "  call ieee_get_status(status)",
        "  call ieee_set_halting_mode(ieee_all, .false.)",
        "  call initialize(stub)",
        "  call ieee_set_status(status)",
        "  passed = run(load_tests)",
        "  call finalize(stub, passed)",
        "",
        "contains",
        "",
        "  function load_tests() result(suite)",
        "    type(TestSuite) :: suite",
        "    character(len=64) :: wanted",
        "",
        "    call get_environment_variable('TEST_SUITE', wanted)",
        "    suite = TestSuite()",
    ]
    for module in modules:
        condition = f"if (wanted == '' .or. wanted == '{module}')"
        lines.append(f"    {condition} call suite%addTest({module}_suite())")
    return "\n".join([*lines, "  end function load_tests", "", f"end program {name}", ""])


def main() -> int:
    """Translate the files on the command line into a folder, with a driver for them.

    Returns
    -------
    int
        Exit code: 0, or 2 if a file is not understood.
    """
    parser = argparse.ArgumentParser(description="Turn pFUnit tests (.pf) into Fortran.")
    parser.add_argument("files", nargs="+", type=Path, help="test modules")
    parser.add_argument("--output", type=Path, default=Path(), help="folder for the results")
    parser.add_argument("--driver", default="run_tests", help="name of the program that runs them")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    suites = []
    try:
        for file in arguments.files:
            text, suite = translate(file.read_text(encoding="utf-8"), file.name)
            (arguments.output / f"{file.stem}.f90").write_text(text, encoding="utf-8")
            suites.append(suite)
    except TranslationError as error:
        print(error, file=sys.stderr)
        return 2
    parallel = any(suite.parallel for suite in suites)
    program = driver(arguments.driver, [suite.module for suite in suites], parallel=parallel)
    (arguments.output / f"{arguments.driver}.f90").write_text(program, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
