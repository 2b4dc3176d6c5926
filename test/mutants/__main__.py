"""Change single lines of the physics, and see whether a test turns red.

By hand: `cd test; ../build/venv/bin/python -m mutants --seed 1 --count 60` tries mutations drawn at
random from all lines of table, gate, events, engine and observe; `--lines src/gate/gate.f90:132`
every mutation of one line; `--chosen` those of `lines.txt`, each with the test that must turn red.
The tests are built in `build/mutants`; a mutant costs seconds, one that survives a minute. The last
line is `N killed, M survived, ...`; the exit code is 1 if any survived.
"""

from __future__ import annotations

import argparse
import random
import sys
from collections import Counter
from pathlib import Path

from support.program import ROOT

from .bench import Bench, Trial
from .mutation import Mutation, mutations, sources

HERE = Path(__file__).resolve().parent
#: Suites without MPI in which the physics and what is measured are met.
SUITES = [
    "test_admit",
    "test_blocks",
    "test_calendar",
    "test_channel",
    "test_collision",
    "test_disc",
    "test_excursion",
    "test_frozen",
    "test_gate",
    "test_identities",
    "test_instant",
    "test_laws",
    "test_laws_statistics",
    "test_observer",
    "test_opening_search",
    "test_ordering",
    "test_polarised_current",
    "test_polygon",
    "test_polygon_engines",
    "test_quantities",
    "test_queue",
    "test_random",
    "test_reservoir",
    "test_rotation",
    "test_half_channel_visits",
    "test_scatterers",
    "test_simulation",
    "test_archive",
    "test_table",
    "test_timestep",
    "test_tournament",
    "test_urn",
]


def listed(name: str) -> list[list[str]]:
    """Read a list of mutations: file, line, changed line, words; an empty line between two."""
    text = (HERE / name).read_text(encoding="utf-8")
    parts = [
        [line.strip() for line in part.splitlines() if line.strip() and not line.startswith("#")]
        for part in text.split("\n\n")
    ]
    return [part for part in parts if part]


def found_again(home: str, line: str, changed: str) -> Mutation:
    """Find the first such line in a file or in the files of a folder; number 0 if it is gone."""
    start = ROOT / home
    for path in [start] if start.is_file() else sorted(start.rglob("*.f90")):
        for number, one in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if one.strip() == line:
                return Mutation(str(path.relative_to(ROOT)), number, line, changed)
    return Mutation(home, 0, line, changed)


def known_equivalent(mutation: Mutation) -> str:
    """Return why no test can tell a mutant from the program; empty if one should."""
    for home, line, changed, *why in listed("equivalent.txt"):
        if mutation.file.startswith(home) and (line, changed) == (
            mutation.line.strip(),
            mutation.changed.strip(),
        ):
            return " ".join(why)
    return ""


def drawn(arguments: argparse.Namespace) -> list[Mutation]:
    """Return the mutations that the command line asks for."""
    if arguments.lines:
        file, _, number = arguments.lines.partition(":")
        return mutations(ROOT / file, int(number) if number else None)
    every = [one for path in sources() for one in mutations(path)]
    return random.Random(arguments.seed).sample(every, min(arguments.count, len(every)))


def show(trial: Trial) -> None:
    """Print one line a mutant, and the test that turned red."""
    words = f"{trial.verdict:14} {trial.mutation.place:44} {trial.mutation.change}"
    print("\n".join([words, *(f"{'':15}{name}" for name in trial.red[:2])]), flush=True)


def try_chosen(bench: Bench, only: str) -> list[Trial]:
    """Try what `lines.txt` has for some files; killed is only what its own test kills."""
    trials = []
    for file, line, changed, test in listed("lines.txt"):
        if only not in file:
            continue
        mutation = found_again(file, line, changed)
        if not mutation.number:
            trials.append(Trial(mutation, "gone"))
            show(trials[-1])
            continue
        trial = bench.attempt(mutation, test.partition(":")[0], every=True)
        if trial.red and test not in trial.red:
            trial.verdict = "survived"
            trial.red.insert(0, f"not by {test}, but by")
        trial.red.sort(key=lambda name, test=test: name != test)
        show(trial)
        trials.append(trial)
    return trials


def try_drawn(bench: Bench, arguments: argparse.Namespace) -> list[Trial]:
    """Try what was drawn at random, or one line."""
    trials = []
    for mutation in drawn(arguments):
        if why := known_equivalent(mutation):
            trial = Trial(mutation, "equivalent", [why])
        else:
            trial = bench.attempt(mutation)
        show(trial)
        trials.append(trial)
    return trials


def main() -> int:
    """Read the command line, and try what it asks for."""
    parser = argparse.ArgumentParser(prog="mutants", description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--seed", type=int, default=1, help="of the choice of mutations")
    parser.add_argument("--count", type=int, default=60, help="how many are drawn")
    parser.add_argument("--lines", metavar="FILE:LINE", help="all mutations of a line or a file")
    parser.add_argument(
        "--chosen",
        nargs="?",
        const="",
        metavar="WORD",
        help="the mutations of lines.txt, in files with this word in their name",
    )
    arguments = parser.parse_args()
    bench = Bench(SUITES)
    if arguments.chosen is None:
        trials = try_drawn(bench, arguments)
    else:
        trials = try_chosen(bench, arguments.chosen)
    counts = Counter(trial.verdict for trial in trials)
    print(
        f"{counts['killed']} killed, {counts['survived']} survived, "
        f"{counts['equivalent']} equivalent, {counts['does not build']} do not build, "
        f"{counts['gone']} gone"
    )
    return 1 if counts["survived"] + counts["gone"] else 0


if __name__ == "__main__":
    sys.exit(main())
