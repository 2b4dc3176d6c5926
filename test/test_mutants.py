"""Lists of mutations name lines that are there: one that rots would look like one that holds."""

import pytest
from mutants.__main__ import HERE, found_again, listed


@pytest.mark.parametrize("name", ["lines.txt", "equivalent.txt"])
def test_every_listed_line_is_in_the_source(name: str) -> None:
    """Each file or folder has the line, and the change changes it."""
    entries = listed(name)
    assert entries, HERE / name
    gone = [
        f"{home}: {line}"
        for home, line, changed, *_ in entries
        if line == changed or not found_again(home, line, changed).number
    ]
    assert not gone


def test_chosen_mutations_name_a_test_of_a_suite() -> None:
    """`suite: test` of each chosen mutation is a procedure of that suite."""
    wrong = []
    for *_, test in listed("lines.txt"):
        suite, _, procedure = test.partition(": ")
        path = HERE.parent / f"{suite}.pf"
        if not path.exists() or f"subroutine {procedure}()" not in path.read_text("utf-8"):
            wrong.append(test)
    assert not wrong
