"""References of input and output, made from the program's keys and from a results file."""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import dataclass
from typing import TYPE_CHECKING

import f90nml
import h5py

if TYPE_CHECKING:
    from pathlib import Path

# Corners of two polygons.
SQUARE = "1, -1, 1, 1, -1, 1, -1, -1"
HOUSE = "1, -1, 1, 1, 0, 2, -1, 1, -1, -1"

# Example of a key: its value, or whole groups if the key needs other keys.
EXAMPLES: dict[str, str | dict[str, dict[str, str]]] = {
    "table/urn_radius": "1, 0.8",
    "table/urn_sides": {"table": {"urn_shape": "'polygon'", "urn_sides": "6"}},
    "table/urn_vertices": {"table": {"urn_shape": "'polygon'", "urn_vertices": SQUARE}},
    "table/urn2_vertices": {
        "table": {"urn_shape": "'polygon'", "urn_vertices": SQUARE, "urn2_vertices": HOUSE}
    },
    "particles/number": "1000",
    "particles/urn1_number": "900",
    "particles/urn1_fraction": "0.9",
    "particles/seed": "42",
    "particles/initial_file": {"particles": {"number": "2", "initial_file": "'start.txt'"}},
    "gate/threshold": "7",
    "gate/threshold_fraction": "0.007",
    "run/transient_collisions": "20000000",
    "run/duration": "5000",
    "run/transient_duration": {"run": {"duration": "5000", "transient_duration": "2000"}},
    "run/start_time": "100",
    "run/time_step": {"run": {"engine": "'timestep'", "time_step": "0.001"}},
    "table/scatterers": "0, 0, 0.002, 0.2, 0.004, 0.002",
    "scan/threshold": "5, 7, 9",
    "scan/threshold_range": "1, 25, 25",
    "scan/threshold2": {"scan": {"threshold": "5, 7", "threshold2": "7, 9"}},
    "scan/threshold2_range": "5, 9, 5",
    "scan/threshold_fraction": "0.005, 0.007",
    "scan/threshold_fraction_range": "0.001, 0.025, 25",
    "scan/number": "500, 1000",
    "scan/number_range": "100, 1000, 10",
    "scan/channel1_width": "0.2, 0.3",
    "scan/channel1_width_range": "0.1, 0.3, 3",
    "scan/channel2_width": "0.01, 0.03",
    "scan/channel2_width_range": "0.002, 0.1, 25",
    "scan/channel1_length": "1, 2",
    "scan/channel1_length_range": "1, 4, 4",
    "scan/channel2_length": "0.5, 1",
    "scan/channel2_length_range": "0.5, 2, 4",
    "scan/urn_radius": "1, 2",
    "scan/urn_radius_range": "1, 2, 3",
    "scan/urn_radius2": {"scan": {"urn_radius": "1, 2", "urn_radius2": "2, 1"}},
    "scan/urn_radius2_range": "1, 2, 3",
    "scan/urn1_fraction": "0.5, 1",
    "scan/urn1_fraction_range": "0.5, 1, 6",
    "scan/replicas": "4",
    **{
        f"precision/{key}": {"scan": {"replicas": "16"}, "precision": {key: value, **beside}}
        for key, value, beside in (
            ("chi_replica_error", "0.001", {}),
            ("polarised_current_replica_error", "0.01", {}),
            ("largest_replicas", "128", {"chi_replica_error": "0.001"}),
        )
    },
    "output/series_interval": "10",
    "output/snapshot_times": "0, 1000, 2000",
    "output/snapshot_times_range": "0, 2000, 3",
    "output/event_log": {"run": {"duration": "50"}, "output": {"event_log": ".true."}},
    "output/final_state": ".true.",
    "limits/wall_minutes": "115",
}
BASE = {"particles": {"number": "1000"}, "gate": {"threshold": "7"}}
# A run of a few particles whose results file has all datasets.
EVERYTHING = """&particles
  number = 100
/
&gate
  threshold = 3
/
&run
  duration = 30
  transient_duration = 10
/
&scan
  threshold = 3
/
&output
  file = 'everything.h5'
  series_interval = 10
  snapshot_times = 0, 10
  event_log = .true.
  final_state = .true.
/
"""
# Attributes of a results file that depend on machine, build or run.
VARYING = {"compiler", "compiler_options", "created", "git_commit", "gsl_library", "hdf5_library",
           "initial_file_fingerprint", "mpi_library", "version"}  # fmt: skip
# An initial file of two particles, for the example that names one.
START = "-2 0.5 1 0\n2 -0.5 0 1\n"
# The allowed values begin with one of these words; before them is the meaning of the key.
TOLD = re.compile(
    r"(.*?); ((?:one (?:whole number|number|text)|whole numbers|numbers|first, last|'|\.true).*)"
)
# The keys for the length of a run.
LENGTHS = {"collisions", "transient_collisions", "duration", "transient_duration"}
# A key and the key that replaces it.
EITHER = {"threshold_fraction": ("gate", "threshold")}


@dataclass(frozen=True)
class Key:
    """A key of the namelist, from the output of the program."""

    group: str
    name: str
    default: str
    meaning: str
    allowed: str
    unit: str
    symbol: str

    @property
    def example(self) -> str:
        """The key in its group, with a value, as a namelist."""
        value = EXAMPLES.get(f"{self.group}/{self.name}", self.default)
        groups = value if isinstance(value, dict) else {self.group: {self.name: value}}
        return written(groups)


def generated(root: Path, folder: Path) -> tuple[dict[str, str], list[str]]:
    """Return the generated parts of pages, and the problems with them.

    A run in `folder` writes a results file with all datasets.
    """
    program = root / "build/bin/battery"
    keys = all_keys(program)
    (folder / "everything.nml").write_text(EVERYTHING)
    subprocess.run([program, "--quiet", "--overwrite", "everything.nml"], cwd=folder, check=True)
    results = folder / "everything.h5"
    help_text = said(program, "--help").split("\nGroups and keys")[0].rstrip()
    parts = {
        "keys": input_table(keys),
        "datasets": output_table(results),
        "help": f"```text\n{help_text}\n```\n",
    }
    return parts, unexplained(results)


def written(groups: dict[str, dict[str, str]]) -> str:
    """Return groups as a namelist."""
    lines = []
    for group, keys in groups.items():
        lines += [f"&{group}", *(f"  {name} = {value}" for name, value in keys.items()), "/"]
    return "\n".join(lines)


def completed(text: str) -> str:
    """Return a namelist completed by the keys that it needs for a valid, short run."""
    groups = f90nml.Parser().reads(text).todict()
    for group, keys in BASE.items():
        for name, value in keys.items():
            there = groups.get(group, {})
            instead = [other for other, place in EITHER.items() if place == (group, name)]
            if not any(one in there for one in (name, *instead)):
                groups.setdefault(group, {})[name] = int(value)
    # `--check` measures the speed of a run, for at most the length of the run.
    if not LENGTHS & groups.setdefault("run", {}).keys():
        groups["run"] |= {"collisions": 100000, "transient_collisions": 0}
    scanned = groups.get("scan", {})
    if any(name.startswith("threshold_fraction") for name in scanned):
        groups["gate"] = {"threshold_fraction": 0.007}
    return str(f90nml.Namelist(groups)) + "\n"


def all_keys(program: Path) -> list[Key]:
    """Return all keys in their order, from `--schema`."""
    found = []
    for group, keys in json.loads(said(program, "--schema"))["properties"].items():
        for name, entry in keys["properties"].items():
            parts = re.split("; (unit|in the paper|default): ", entry["description"])
            of = dict(zip(parts[1::2], parts[2::2], strict=True))
            place = (of.get("default", ""), *_meaning_and_allowed(parts[0]))
            found.append(Key(group, name, *place, of.get("unit", ""), of.get("in the paper", "")))
    return found


def _meaning_and_allowed(text: str) -> tuple[str, str]:
    match = TOLD.fullmatch(text)
    if match is None:
        raise ValueError(f"no meaning and allowed values of a key: {text}")
    return match[1], match[2]


def said(program: Path, option: str) -> str:
    """Return the output of the program for an option."""
    return subprocess.run(
        [program, option], check=False, text=True, stdin=subprocess.DEVNULL, capture_output=True
    ).stdout


def input_table(keys: list[Key]) -> str:
    """Return the reference of all keys, with a heading for each group and key."""
    lines, group = [], ""
    for key in keys:
        if key.group != group:
            group = key.group
            lines += [f"### &{group}", ""]
        lines += [f"#### {key.name}", "", f"{sentence(key.meaning)}", ""]
        lines += ["| default | allowed | unit | in the paper |", "| --- | --- | --- | --- |"]
        default = f"`{key.default}`" if key.default else "none"
        lines += [f"| {default} | {key.allowed} | {key.unit or '-'} | {key.symbol or '-'} |", ""]
        lines += ["```fortran", key.example, "```", ""]
    return "\n".join(lines)


def sentence(text: str) -> str:
    """Return a text as a sentence."""
    return f"{text[:1].upper()}{text[1:]}."


def output_table(path: Path) -> str:
    """Return the reference of all datasets and attributes of a results file."""
    lines = []
    with h5py.File(path, "r") as file:
        groups: dict[str, list[h5py.Dataset]] = {}

        def keep(_: str, item: object) -> None:
            if isinstance(item, h5py.Dataset) and not _is_axis(item):
                groups.setdefault(item.parent.name.strip("/"), []).append(item)

        file.visititems(keep)
        for group, datasets in groups.items():
            lines += [f"### {f'Group {group}' if group else 'Datasets'}", ""]
            lines += ["| name | unit | of each | what |", "| --- | --- | --- | --- |"]
            lines += [_row(one) for one in datasets] + [""]
        lines += ["### Attributes of the file", "", "| name | for example |", "| --- | --- |"]
        for name, value in file.attrs.items():
            text = value.decode() if isinstance(value, bytes) else str(value)
            first = text.strip().splitlines()[0] if text.strip() else ""
            if not name.startswith("_NC"):
                lines.append(f"| `{name}` | {'' if name in VARYING else f'`{first}`'} |")
    return "\n".join(lines) + "\n"


def unexplained(path: Path) -> list[str]:
    """Return the datasets of a results file without a unit or a meaning."""
    missing = []
    with h5py.File(path, "r") as file:

        def look(name: str, item: object) -> None:
            if isinstance(item, h5py.Dataset) and not _is_axis(item):
                lacks = [one for one in ("units", "long_name") if one not in item.attrs]
                missing.extend(f"results file: {name} has no {one}" for one in lacks)

        file.visititems(look)
    return missing


def _is_axis(item: h5py.Dataset) -> bool:
    return "without corresponding variable" in _text(item.attrs.get("NAME", ""))


def _row(item: h5py.Dataset) -> str:
    axes = []
    for axis in item.dims:
        scale = axis[0].name.rsplit("/", 1)[-1] if len(axis) else axis.label
        axes.append(scale)
    name = item.name.rsplit("/", 1)[-1]
    unit, meaning = (_text(item.attrs.get(one, "")) for one in ("units", "long_name"))
    meaning = meaning.replace("|", "\\|")
    return f"| `{name}` | {unit} | {', '.join(axes) or '-'} | {meaning} |"


def _text(value: object) -> str:
    if hasattr(value, "ravel"):
        value = value.ravel()[0] if value.size else ""
    return value.decode().strip() if isinstance(value, bytes) else str(value).strip()
