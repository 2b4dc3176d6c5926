"""Make the frozen answers anew, and check them against quadruple precision.

By hand, after `make build build/bin/events-real64 build/bin/events-real128`:

    PYTHONPATH=.:test build/venv/bin/python -m frozen.freeze [NAME ...]

The times and places that are written are those of quadruple precision. A case is only written if
the program finds the same events in the same order by every engine, and if events that are not of
one instant are further apart than the tolerance. `own` makes the run that the program has in itself
for `--self-test`.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import h5py
import numpy as np
from support.program import ROOT, namelist, run

from .cases import CASES, OWN, STOCHASTIC, Case
from .frozen_file import EXACT, FOLDER, Answer, Frozen, write_frozen

Differences = dict[str, tuple[float, float]]
# So many times the greatest difference that was seen is allowed; never less than `LEAST`, and
# never more than `MOST`, in units of the radius.
MARGIN, LEAST, MOST = 100.0, 1.0e-12, 2.0e-6
# The module with the program's own run, whose numbers have so many digits behind the point, between
# these comments.
SELF_TEST, DIGITS = ROOT / "src/ensemble/self_test.f90", 12
BEGIN = "  ! Written by test/frozen/freeze.py from a run in quadruple precision.\n\n"
END = "  ! End of what freeze.py writes.\n"


class NotFrozenError(Exception):
    """An answer that cannot be kept."""


def input_of(case: Case) -> tuple[str, str]:
    """Give namelist and initial file."""
    table, particles = case.table, case.particles()
    text = namelist(
        table={
            "shape": f"'{table.shape}'",
            "urn_radius": table.radius,
            "channel1_width": table.width1,
            "channel1_length": table.length1,
            "channel2_width": table.width2,
            "channel2_length": table.length2,
        },
        particles={"number": len(particles), "initial_file": "'start.txt'"},
        gate={"threshold": case.threshold},
        run={
            "engine": "'excursion'",
            "time_step": case.time_step,
            "duration": case.duration,
            "start_time": case.start_time,
        },
        output={"file": "'out.h5'", "event_log": ".true.", "final_state": ".true."},
    )
    return text, "".join(" ".join(map(repr, map(float, one))) + "\n" for one in particles)


def of_program(frozen: Frozen, engine: str) -> Answer:
    """Run the program."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "case.nml").write_text(frozen.input_of(engine), encoding="utf-8")
        (folder / "start.txt").write_text(frozen.particles, encoding="utf-8")
        ended = run("--quiet", "case.nml", folder=folder)
        if ended.returncode:
            raise NotFrozenError(ended.stderr)
        return read_answer(folder / "out.h5")


def read_answer(path: Path) -> Answer:
    """Read events and final state of a results file."""
    with h5py.File(path) as file:
        events = np.stack([file["events"][key][()] for key in ("kind", "where", "particle")], 1)
        final = np.stack([file["final"][key][0, 0] for key in ("x", "y", "ux", "uy")], 1)
        return Answer(events, file["events/time"][()], final, 0.0, 0.0)


def of_precision(case: Case, particles: str, engine: str, bits: int = 128) -> Answer:
    """Run the same in another precision, quadruple precision by default."""
    table = case.table
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as file:
        file.write(particles)
        file.flush()
        numbers = [
            len(particles.splitlines()),
            case.threshold,
            case.time_step,
            table.radius,
            table.width1,
            table.length1,
            table.width2,
            table.length2,
            case.start_time,
            case.duration,
        ]
        asked = f"{engine} {table.shape} '{file.name}'\n{' '.join(map(str, numbers))}\n"
        ended = subprocess.run(
            [ROOT / f"build/bin/events-real{bits}"],
            input=asked,
            check=True,
            text=True,
            capture_output=True,
            timeout=600,
        )
    lines = [line.split() for line in ended.stdout.splitlines()]
    events = [line[1:] for line in lines if line[0] == "event"]
    final = [line[1:] for line in lines if line[0] == "final"]
    whole = np.array([line[:3] for line in events], dtype=int).reshape(-1, 3)
    return Answer(
        whole, np.array([float(line[3]) for line in events]), np.array(final, dtype=float), 0.0, 0.0
    )


def difference(one: Answer, other: Answer, name: str) -> tuple[float, float]:
    """Give the greatest differences of times and places of two runs of the same events."""
    if one.events.shape != other.events.shape or (one.events != other.events).any():
        common = min(len(one.events), len(other.events))
        apart = np.flatnonzero((one.events[:common] != other.events[:common]).any(1))
        first = int(apart[0]) if apart.size else common
        raise NotFrozenError(
            f"{name}: {len(one.events)} and {len(other.events)} events, which "
            f"differ from number {first} of t = {one.times[first - 1]}"
        )
    return float(abs(one.times - other.times).max()), float(abs(one.final - other.final).max())


def settled(exact: Answer, differences: Differences, radius: float, name: str) -> Answer:
    """Give the answer its tolerances; events must be further apart than that, or of one instant."""
    greatest = [max(values) for values in zip(*differences.values(), strict=True)]
    exact.tolerance, exact.final_tolerance = (
        float(f"{max(MARGIN * value, LEAST * radius):.1e}") for value in greatest
    )
    if max(exact.tolerance, exact.final_tolerance) > MOST * radius:
        raise NotFrozenError(f"{name}: rounding grows to {max(greatest):.1e}: shorten the run")
    gaps = np.diff(exact.times)
    near = gaps[(gaps > 1.0e-15) & (gaps < 2 * exact.tolerance)]
    if near.size:
        raise NotFrozenError(
            f"{name}: events only {near.min():.1e} apart, {exact.tolerance:.1e} "
            "is the tolerance: take another seed"
        )
    return exact


def freeze(case: Case) -> str:
    """Make one file; tell what it was checked against."""
    frozen = Frozen(*input_of(case), {})
    notes = {}
    told = []
    for name, engines in (("exact", case.engines), ("timestep", ("timestep",))):
        reference = "collision" if name == "exact" else name
        answer = of_precision(case, frozen.particles, reference)
        differences = {
            engine: difference(answer, of_program(frozen, engine), engine) for engine in engines
        }
        frozen.answers[name] = settled(answer, differences, case.table.radius, name)
        seen = ", ".join(
            f"{engine} {times:.1e} {places:.1e}" for engine, (times, places) in differences.items()
        )
        answer.engines = engines
        notes[name] = f"{len(answer.events)} events of {reference} in real128; "
        notes[name] += f"times and places differ by: {seen}"
        told.append(notes[name])
    write_frozen(FOLDER / f"{case.name}.txt", case.about, frozen, notes)
    return "; ".join(told)


def numbers(case: Case, particles: str, answer: Answer, digits: str) -> list[str]:
    """Give a case as `test_frozen.pf` reads it: numbers alone, counts first."""
    table = case.table
    lengths = (table.radius, table.width1, table.length1, table.width2, table.length2)
    lines = [
        f"{len(particles.splitlines())} {len(answer.events)} {case.threshold} "
        f"{1 + (table.shape == 'urn')}",
        f"{case.duration} {answer.tolerance:.1e} {answer.final_tolerance:.1e} {case.time_step}",
        " ".join(map(str, lengths)),
        *particles.splitlines(),
    ]
    lines += [
        f"{kind} {where} {particle} {time:{digits}}"
        for (kind, where, particle), time in zip(
            answer.events.tolist(), answer.times.tolist(), strict=True
        )
    ]
    return lines + [" ".join(f"{value:{digits}}" for value in row) for row in answer.final.tolist()]


def frozen_reservoir(case: Case, particles: str) -> tuple[Answer, str]:
    """Find the answer of `reservoir`; tell how far real64 is from it."""
    answer = of_precision(case, particles, "reservoir")
    found = difference(answer, of_precision(case, particles, "reservoir", 64), "reservoir")
    settled(answer, {"reservoir": found}, case.table.radius, "reservoir")
    return answer, (
        f"{len(answer.events)} events of reservoir in real128; times and places of "
        f"real64 differ by {found[0]:.1e} {found[1]:.1e}"
    )


def freeze_stochastic(case: Case) -> str:
    """Make one file that a Fortran test reads."""
    particles = input_of(case)[1]
    answer, told = frozen_reservoir(case, particles)
    text = "\n".join(numbers(case, particles, answer, ".15e")) + "\n"
    (FOLDER / f"{case.name}.dat").write_text(text, encoding="utf-8")
    return told


def freeze_own() -> str:
    """Write the run that the program has in itself."""
    frozen = Frozen(*input_of(OWN), {})
    answer = of_precision(OWN, frozen.particles, "collision")
    differences = {
        engine: difference(answer, of_program(frozen, engine), engine) for engine in EXACT
    }
    settled(answer, differences, OWN.table.radius, "own")
    # No closer than the digits that are kept.
    least = MARGIN * 10.0**-DIGITS
    rows = numbers(OWN, frozen.particles, answer, f".{DIGITS}f")[3:]
    starts, events = len(frozen.particles.splitlines()), len(answer.events)
    lines = [
        "  !> Largest differences of times, and of final positions and velocities.",
        f"  real(wp), parameter :: time_tolerance = {max(answer.tolerance, least):.1e}_wp, "
        f"final_tolerance = {max(answer.final_tolerance, least):.1e}_wp",
        *array_of("start_lines", "x, y, ux, uy of each particle at the start", rows[:starts]),
        *array_of("event_lines", "Kind, where, particle, time of each event",
                  rows[starts:starts + events]),
        *array_of("final_lines", "x, y, ux, uy of each particle at the end",
                  rows[starts + events:]),
    ]  # fmt: skip
    before, _, rest = SELF_TEST.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    SELF_TEST.write_text(before + BEGIN + "\n".join(lines) + "\n\n" + END + after, encoding="utf-8")
    return f"{events} events"


def array_of(name: str, about: str, rows: list[str]) -> list[str]:
    """Write an array of texts in Fortran."""
    width = max(map(len, rows))
    kind = f"character(len={width})"
    return [
        "",
        f"  !> {about}.",
        f"  {kind}, parameter :: {name}({len(rows)}) = [{kind} :: &",
        *(f"    '{row}', &" for row in rows[:-1]),
        f"    '{rows[-1]}']",
    ]


def main() -> int:
    """Make all cases, or those that are named."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("names", nargs="*", help="cases; all if none is named")
    names = parser.parse_args().names
    failed = 0
    ways = {case.name: partial(freeze, case) for case in CASES}
    ways |= {case.name: partial(freeze_stochastic, case) for case in STOCHASTIC}
    ways["own"] = freeze_own
    for name, make in ways.items():
        if names and name not in names:
            continue
        try:
            print(f"{name}: {make()}", flush=True)
        except NotFrozenError as error:
            failed += 1
            print(f"{name}: NOT FROZEN: {error}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
