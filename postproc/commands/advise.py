"""Advises a theory or run that is accurate enough for a quantity of one circuit, as JSON.

Input is a namelist, or the circuit by options as of `theory` (--number N --threshold T ...). A
pilot of the program, about a second at N = 1000, shows the scatter of replicas and the errors of
theories; one that would take more than a minute is run only if --pilot-seconds allows it. The
transient of the pilot of a current lasts until the part missing since circulations still build up
is a quarter of the tolerance. The pilot is data: if it meets the tolerance its value (`expected`)
is the answer, and cpu_seconds is 0 or that of a theory. It has the seed of the namelist, if any.
Runs begin with urn1_number or urn1_fraction of the namelist, else with a twentieth of the particles
in urn 1 (for a transition three tenths), not with half of them as the program does.
The last line, on standard error, is the advice in a sentence. `duration` includes the transient, as
in the namelist. `confidence` is the probability that the tolerance is met. If the quantity does not
exist, or the pilot does not tell it from 0 by three errors, `rung` is "none". Namelists with
polygons or scatterers are refused, and so are scans of several points.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from postproc import cli
from postproc.advice.advice import QUANTITIES, table_of
from postproc.advice.question import advice_on, circuit_of
from postproc.commands.circuit_options import circuit_options, given_circuit

if TYPE_CHECKING:
    import argparse

    from postproc.advice.advice import Advice


def _add(options: argparse.ArgumentParser) -> None:
    options.add_argument("--quantity", choices=QUANTITIES, default="chi", help="(default: chi)")
    options.add_argument(
        "--tolerance", type=float, default=0.02, metavar="SHARE",
        help="relative, from 1e-4 to 1 (default: 0.02)",
    )  # fmt: skip
    options.add_argument(
        "--pilot-seconds", type=float, default=60.0, metavar="S",
        help="processor time that the pilot may take (default: 60)",
    )  # fmt: skip


def sentence(given: Advice, quantity: str, tolerance: float) -> str:
    """Return the advice as a sentence."""
    if given.rung == "none":
        return given.reason
    chance = min(99.0, 100.0 * given.confidence)
    sure = f"{quantity} within {100.0 * tolerance:g} %, {chance:.0f} % sure"
    if given.replicas == 0 and quantity == "transition":
        return f"For {sure}, the theory {given.rung} is enough. {given.reason}"
    if given.replicas == 0:
        return f"For {sure}, ask battery-postproc theory --theory {given.rung}. {given.reason}"
    if given.cpu_seconds == 0.0:
        return f"The pilot is enough: {given.expected:.6g} is {sure}. {given.reason}"
    return (
        f"For {sure}, run {given.rung} in {given.replicas} replicas of {given.duration:g} time "
        f"units each, the first {given.transient_duration:g} unmeasured: {given.cpu_seconds:.2g} s "
        f"of a processor. {given.reason}"
    )


def main(arguments: list[str] | None = None) -> int:
    """Print the advice as JSON, and in a sentence to standard error."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    if any(word.split("=")[0] == "--number" for word in words):
        options = circuit_options("advise", __doc__)
        _add(options)
        given = options.parse_args(words)
        circuit = given_circuit(given)
        groups = table_of(circuit)
    else:
        options = cli.parser("advise", __doc__)
        options.add_argument("file", metavar="FILE.nml", type=Path, help="or --number N ...")
        _add(options)
        given = options.parse_args(words)
        groups, circuit = circuit_of(given.file)
    found = advice_on(groups, circuit, given.quantity, given.tolerance, given.pilot_seconds)
    print(json.dumps(cli.finite(vars(found)), indent=2))
    print(sentence(found, given.quantity, given.tolerance), file=sys.stderr)
    return 0
