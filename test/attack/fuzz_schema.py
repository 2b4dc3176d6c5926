"""Mutants of namelists, each told to the schema of `battery --schema` and to the program.

What f90nml writes of a mutant is tried, so that what it cannot read without loss plays no part.
What the program refuses for a name, a type or a bound of one key, the schema must refuse; what the
program takes, the schema must take.

    python test/attack/fuzz_schema.py                     # 5,000 mutants
    python test/attack/fuzz_schema.py 500 --seed 7
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import random
import re
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import f90nml
import jsonschema
from support.program import ROOT, run

from attack.fuzz_input import NAMELISTS, mutant_of

Json = dict[str, Any]
# What the program says of a name, a type or a bound; rules between keys have other words.
OWN = re.compile(r"(?:: (?:there is no such|is |has |how many|begins )|; allowed: numbers up to).*")
BASES = [*NAMELISTS, *(path.read_text() for path in sorted((ROOT / "namelists").glob("*.nml")))]
VALUES: list[Any] = [
    0, 1, 2, -1, 0.5, -0.5, 1.5, 2e9, 3e9, 2**31, 10**17, 10**18, 1e300, True, False, "", "text",
    "urn", "timestep", " a", "a\tb", "x" * 3999, [1, 2], [0.5, 0.25], [1, 9, 3], [1, 9, 3.5],
    [1, 9, 0], [1, 2, 3, 4], ["a", "b"], [1, "a"], [True, 1], [1, 200000001, 2], [5], [1, None, 2],
]  # fmt: skip


def schema_of(folder: Path) -> jsonschema.Draft202012Validator:
    """Ask the program for its schema, which must be one."""
    schema = json.loads(run("--schema", folder=folder).stdout)
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def as_json(value: Any) -> Any:  # noqa: ANN401
    """Give what JSON says of a value; it knows one kind of numbers, so that 5.0 is 5."""
    if isinstance(value, dict):
        return {key: as_json(one) for key, one in value.items()}
    if isinstance(value, list):
        return [as_json(one) for one in value]
    return int(value) if isinstance(value, float) and value == int(value) else value


def read(text: str) -> Json | None:
    """Read a namelist with f90nml; nothing if it cannot, or if JSON has no word for a value."""
    # It would fill the memory with so many values, or places before an index.
    if re.search(r"\d{6}\d*\s*[*)]", text):
        return None
    try:
        # It prints what it was about when it gives up.
        with contextlib.redirect_stdout(io.StringIO()):
            return as_json(json.loads(json.dumps(f90nml.reads(text), allow_nan=False)))
    except Exception:  # f90nml raises whatever comes
        return None


def changed(case: Json, names: list[tuple[str, str]], dice: random.Random) -> Json:
    """Change one value, one name of a key, its group, or the name of a group."""
    case = json.loads(json.dumps(case))
    group, key = dice.choice(names)
    match dice.randrange(5):
        case 0:
            key = dice.choice([key + "s", key[1:] + "x", dice.choice(names)[1]])
        case 1:
            group = dice.choice([group + "s", dice.choice(names)[0]])
    case.setdefault(group, {})[key] = dice.choice(VALUES)
    return case


def fault_of(number: int, schema: jsonschema.Draft202012Validator, folder: Path) -> tuple[str, str]:
    """Try one mutant; give what was the case, and what is wrong (nothing: empty)."""
    dice = random.Random(number)
    base = dice.choice(BASES)
    groups = schema.schema["properties"]
    names = [(group, key) for group in groups for key in groups[group]["properties"]]
    text = mutant_of(base, dice) if number % 2 else str(f90nml.Namelist(
        changed(read(base) or {}, names, dice)))
    case = read(text)
    try:
        text = str(f90nml.Namelist(case)) if case is not None else ""
    except Exception:
        case = None
    if case is None or read(text) != case:
        return "lost by f90nml", ""
    (folder / "case.nml").write_text(text)
    (folder / "start.txt").write_text("-1.4 0.1 1 0\n" * 4)
    ended = run("--check", "case.nml", folder=folder)
    taken = schema.is_valid(case)
    if ended.returncode == 0:
        return "taken", "" if taken else f"only the schema refuses {text}"
    own = OWN.search(ended.stderr)
    if not own:
        return "refused for a rule between keys", ""
    return "refused", f"only the program refuses ({own.group()}) {text}" if taken else ""


def main() -> int:
    """Attack, and say what came of it; give 1 if there are faults."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("count", nargs="?", type=int, default=5000, help="how many mutants")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first; the others follow")
    arguments = parser.parse_args()
    counts: Counter[str] = Counter()
    faults = 0
    with tempfile.TemporaryDirectory(prefix="battery_schema_") as name:
        schema = schema_of(Path(name))
        for number in range(arguments.seed, arguments.seed + arguments.count):
            what, fault = fault_of(number, schema, Path(name))
            counts[what] += 1
            faults += bool(fault)
            if fault:
                print(f"seed {number}: {fault}", flush=True)
    print(", ".join(f"{count} {what}" for what, count in sorted(counts.items())))
    print(f"{faults} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
