"""Namelists as `battery --schema` and f90nml see them; namelists drawn from the list of keys."""

from __future__ import annotations

import contextlib
import io
import json
import re
from typing import TYPE_CHECKING, Any

import f90nml
import jsonschema
from hypothesis import strategies
from support.program import ROOT, run

if TYPE_CHECKING:
    from pathlib import Path

    from hypothesis.strategies import SearchStrategy

Json = dict[str, Any]
LENGTH = re.compile(r"(?m)^( +(?:transient_)?(?:collisions|duration) = )([0-9.]+)$")


def short(text: str) -> str:
    """Make a run a thousandth as long: --check finds out how fast it is, which takes seconds."""
    if "snapshot_times" in text:
        return text  # They would come after the end.
    return LENGTH.sub(lambda found: f"{found[1]}{max(1, int(float(found[2])) // 1000)}", text)


BASES = [short(path.read_text()) for path in sorted((ROOT / "namelists").glob("*.nml"))]
# At and beyond the bounds of keys; of wrong types; ranges and lists of wrong lengths.
NUMBERS = [0, 1, 2, -1, 0.5, -0.5, 1.5, 2e9, 3e9, 2**31, 10**17, 10**18, 1e300]
TEXTS = ["", "text", "urn", "timestep", " a", "a\tb", "x" * 3999]
LISTS = [[1, 9, 3], [1, 9, 3.5], [1, 9, 0], [1, 200000001, 2], ["a", "b"], [1, "a"], [True, 1],
         [1, None, 2]]  # fmt: skip


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
    try:
        # It prints what it was about when it gives up.
        with contextlib.redirect_stdout(io.StringIO()):
            return as_json(json.loads(json.dumps(f90nml.reads(text), allow_nan=False)))
    except Exception:  # f90nml raises whatever comes
        return None


def fitting(kind: Json) -> SearchStrategy[Any]:  # noqa: PLR0911 (one for each type)
    """Draw a value that the schema of a key allows."""
    if "anyOf" in kind:
        return strategies.sampled_from(kind["anyOf"]).flatmap(fitting)
    least, most = kind.get("minimum", kind.get("exclusiveMinimum", -1000)), kind.get("maximum")
    match kind.get("type"):
        case "integer":
            return strategies.integers(least, most)
        case "number":
            return strategies.floats(least, most or 1e6, exclude_min="exclusiveMinimum" in kind,
                                     allow_subnormal=False)  # fmt: skip
        case "boolean":
            return strategies.booleans()
        case "array" if "prefixItems" in kind:
            return strategies.tuples(*map(fitting, kind["prefixItems"])).map(list)
        case "array":
            fewest, most = kind.get("minItems", 1), min(kind.get("maxItems", 4), 4)
            return strategies.lists(fitting(kind["items"]), min_size=fewest, max_size=most)
    return strategies.sampled_from(kind.get("enum", TEXTS))


def namelists(schema: Json) -> SearchStrategy[str]:
    """Draw one of our namelists with a few keys set; what f90nml would lose is not drawn."""
    kinds = {(group, key): kind for group, keys in schema["properties"].items()
             for key, kind in keys["properties"].items()}  # fmt: skip
    groups = sorted({group for group, _ in kinds})
    names = strategies.sampled_from(list(kinds))
    # A key that there is; or one under the name or in the group of another, or of none.
    other = strategies.tuples(
        strategies.sampled_from([*groups, "outputs"]),
        names.flatmap(lambda key: strategies.sampled_from([key[1], key[1] + "s", key[1][1:]])),
    )
    numbers = (
        strategies.sampled_from(NUMBERS)
        | strategies.integers(0, 2**31)
        | strategies.floats(0.0, 1e6, allow_subnormal=False)
    )
    value = (
        numbers
        | strategies.sampled_from(TEXTS)
        | strategies.booleans()
        | strategies.lists(numbers, min_size=1, max_size=4)
        | strategies.sampled_from(LISTS)
    )
    right = names.flatmap(lambda key: strategies.tuples(strategies.just(key), fitting(kinds[key])))
    wrong = strategies.tuples(names | other, value)
    changes = strategies.lists(right, min_size=1, max_size=2) | strategies.lists(
        wrong, min_size=1, max_size=1
    )

    def text(base: str, changes: list[tuple[tuple[str, str], Any]]) -> str:
        case = read(base) or {}
        for (group, key), given in changes:
            case.setdefault(group, {})[key] = given
        try:
            return str(f90nml.Namelist(as_json(case)))
        except Exception:  # as above
            return ""

    drawn = strategies.builds(text, strategies.sampled_from(BASES), changes)
    return drawn.filter(lambda one: (case := read(one)) is not None
                        and read(str(f90nml.Namelist(case))) == case)  # fmt: skip
