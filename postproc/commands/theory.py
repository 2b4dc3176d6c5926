"""Prints, as JSON, the results of a theory for one circuit: stationary states, transition.

Options are named like the keys of the namelist; lengths are over the speed v = 1. Without --theory
the results are those of window, the paper's theory, and under its own name those of direction, or
of renewal for polygons and unequal urns or gates. The net current of direction includes
circulation, which is printed as well. It is that of a run of the given age, and
net_current_infinite_age that which no run reaches: circulations of ever more rounds build up. With
--tricritical, for window and renewal: the point on the line of transition at which a jump becomes
continuous, at this T, w, l and r, and which of the two the transition is at this N.
"""

from __future__ import annotations

import argparse
import json

from postproc import cli
from postproc.commands.circuit_options import beside, circuit_options, given_circuit, given_models
from postproc.progress import doing
from postproc.theory import tricritical
from postproc.theory.circuit import PAPERS_AGE
from postproc.theory.models import MODELS, describe


def main(arguments: list[str] | None = None) -> int:
    """Print the theory of one circuit as JSON."""
    options = circuit_options("theory", __doc__)
    options.add_argument(
        "--tricritical", action="store_true", help="where the transition turns into a jump"
    )
    options.add_argument(
        "--age", type=cli.allowed(float, 0.0, 1e100), metavar="A",
        help=f"of the run, for its net current (default: {PAPERS_AGE:g}, that of the paper's runs)",
    )  # fmt: skip
    given = options.parse_args(arguments)
    circuit = given_circuit(given)
    models = given_models(given, circuit)
    for option, able in (("age", "aged"), ("tricritical", "mixed")):
        if getattr(given, option) and not any(getattr(one, able) for one in models):
            known = " or ".join(name for name, one in MODELS.items() if getattr(one, able))
            raise cli.InputError(f"--{option} is of --theory {known}")
    answers = []
    for model in models:
        with doing(f"theory {model.name}"):
            answers.append(describe(circuit, model))
        if given.tricritical and model.mixed:
            # It does not depend on N, but from T = N on no gate reverses.
            number = max(given.number, *(one + 1 for one in given.threshold))
            unlimited = given_circuit(argparse.Namespace(**vars(given) | {"number": number}))
            there = tricritical.tricritical(model.of(unlimited))
            answers[-1]["transition"] = tricritical.order(model.of(circuit))
            answers[-1]["tricritical"] = vars(there) if there else None
    print(json.dumps(beside(models, answers), indent=2))
    return 0
