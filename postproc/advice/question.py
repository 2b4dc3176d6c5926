"""A question for advice: which theory or run is accurate enough for a quantity of one circuit."""

from __future__ import annotations

import io
import math
import tempfile
from collections.abc import Mapping
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from postproc import cli
from postproc.advice import advice
from postproc.advice.advice import table_of
from postproc.circuits import Circuit
from postproc.reading.grid import groups_in
from postproc.running import plan, write_namelist

if TYPE_CHECKING:
    from postproc.advice.advice import Advice, Groups
    from postproc.theory.circuit import Circuit as Model

KNOWN = {
    "table": ("urn_radius", "channel1_width", "channel1_length", "channel2_width",
              "channel2_length"),
    "gate": ("threshold", "threshold_fraction"),
    "particles": ("number", "urn1_number", "urn1_fraction", "seed", "initial_file"),
}  # fmt: skip


def advise(
    namelist: str | Path | Groups,
    quantity: str = "chi",
    tolerance: float = 0.02,
    *,
    pilot_seconds: float = 60.0,
) -> Advice:
    """Return a theory or run that is accurate enough for a quantity of one circuit.

    A pilot of the program, about a second at N = 1000, shows the scatter of replicas and the errors
    of theories.

    Parameters
    ----------
    namelist
        A file, or values by group and key, of one point.
    quantity
        "chi", "polarised_current" or "transition".
    tolerance
        Relative, from 1e-4 to 1.
    pilot_seconds
        Processor time that the pilot may take.

    Returns
    -------
    Advice
        `rung`, the theory or engine, with the keys of its run (`replicas`, `duration` ...), the
        `reason`, and `cpu_seconds`.

    Raises
    ------
    InputError
        There is no such quantity, tolerance or time, or no advice on such a table: polygons, discs,
        several points; a transition of unequal urns or gates.

    Examples
    --------
    >>> found = advise({"particles": {"number": 100}, "gate": {"threshold": 5}}, tolerance=0.1)
    >>> found.rung
    'excursion'
    """
    if quantity not in advice.QUANTITIES:
        known = ", ".join(advice.QUANTITIES)
        raise cli.InputError(f"there is no quantity {quantity!r}; there are {known}")
    return advice_on(*circuit_of(namelist), quantity, tolerance, pilot_seconds)


def advice_on(
    groups: Groups, circuit: Model, quantity: str, tolerance: float, pilot_seconds: float
) -> Advice:
    """Return advice on a circuit, of which `groups` are what a namelist says."""
    numbers = ("tolerance", tolerance, 1e-4, 1.0), ("pilot_seconds", pilot_seconds, 1.0, 1e100)
    for name, value, low, high in numbers:
        if not (isinstance(value, (int, float)) and low <= value <= high):
            told = f"must be a number from {low:g} to {high:g}"
            raise cli.InputError(f"{name} = {value!r}: {told}")
    if circuit.outline is not None:
        raise cli.InputError("there is no advice on polygons")
    if quantity == "transition" and circuit.unlike:
        raise cli.InputError(f"there is no advice on a transition where {circuit.unlike}")
    if quantity != "chi" and np.all(np.equal(circuit.channel2_width, 0.0)):
        raise cli.InputError(f"without channel 2 there is no {quantity}")
    return advice.advise(groups, circuit, quantity, tolerance, longest=pilot_seconds)


def circuit_of(namelist: str | Path | Groups) -> tuple[Groups, Model]:
    """Return the groups table, particles and gate of a namelist of one circuit, and the circuit."""
    path, groups = _of_one_point(namelist)
    particles, gate = groups.get("particles", {}), groups.get("gate", {})
    if particles.get("initial_file"):
        raise cli.InputError(f"{path}: there is no advice on &particles initial_file")
    number = particles.get("number")
    if not isinstance(number, int):  # f90nml reads less than the program
        raise cli.InputError(f"{path}: &particles number is not found")
    fractions = np.atleast_1d(gate.get("threshold_fraction", []))
    thresholds = gate.get("threshold", [_nearest(one * number) for one in fractions])
    circuit = Circuit(number, thresholds, **groups.get("table", {})).model()
    own = table_of(circuit)
    share = particles.get("urn1_fraction")
    start = particles.get("urn1_number") if share is None else _nearest(share * number)
    if start is not None:
        own["particles"]["urn1_number"] = start
    if "seed" in particles:
        own["particles"]["seed"] = particles["seed"]
    return own, circuit


def _of_one_point(namelist: str | Path | Groups) -> tuple[str, dict[str, Any]]:
    """Return name and groups of a namelist, with what it scans, of one value, in their groups."""
    path, groups = _groups_of(namelist)
    for keys in groups.values():  # Fortran pads texts with blanks
        keys |= {key: one.rstrip() for key, one in keys.items() if isinstance(one, str)}
    table = groups.get("table", {})
    for key, usual in (("shape", "circuit"), ("urn_shape", "disc")):
        if table.get(key) == usual:
            del table[key]
    for name, keys in KNOWN.items():
        strange = sorted(set(groups.get(name, {})) - set(keys))
        if strange:
            raise cli.InputError(f"{path}: there is no advice on &{name} {strange[0]}")
    scanned = {key: value for key, value in groups.get("scan", {}).items() if key != "replicas"}
    for key, value in scanned.items():
        group = next((name for name, keys in KNOWN.items() if key in keys), "")
        if not group:
            raise cli.InputError(f"{path}: there is no advice on &scan {key}")
        if isinstance(value, list) or key.endswith("_range"):
            raise cli.InputError(f"{path}: &scan {key}: there is advice on one point only")
        groups.setdefault(group, {})[key] = value
    return path, groups


def _nearest(number: float) -> int:
    """Return the nearest whole number, of two the greater, as the program does."""
    return math.floor(number + 0.5)


def _groups_of(namelist: str | Path | Groups) -> tuple[str, dict[str, Any]]:
    """Return the name of a namelist for messages, and its values by group and key.

    The program says what is wrong with it.
    """
    if isinstance(namelist, Mapping):
        name, content = "the namelist", write_namelist(None, namelist).encode()
    else:
        path = cli.existing_file(cli.path_of(namelist, "namelist"))
        name, content = str(path), path.read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder, "namelist.nml")
        copy.write_bytes(content)
        try:
            plan(copy, overwrite=True)
        except cli.InputError as problem:
            raise cli.InputError(str(problem).replace(str(copy.resolve()), name)) from problem
    with redirect_stdout(io.StringIO()):  # f90nml prints what it does not understand
        groups = groups_in(content.decode("utf-8-sig", errors="replace").replace("/&", "/ &"))
    # Of values with indices f90nml makes lists, and adds their places.
    return name, {group: {key: value[0] if isinstance(value, list) and len(value) == 1 else value
                          for key, value in keys.items()
                          if value is not None and key != "_start_index"}
                  for group, keys in groups.items()}  # fmt: skip
