"""Results of a theory for one circuit, as JSON: stationary states, transition.

Options are named like the keys of the namelist; lengths are over the speed v = 1. The net current
of two_port and direction includes circulation, which is printed as well. All except window and
renewal always count particles in the channels. With --tricritical, for theories of well mixed urns:
the point on the line of transition at which a jump becomes continuous, at this T, w, l and r, and
which of the two the transition is at this N. The net current of direction is that of a run of the
given age, and net_current_infinite_age that which no run reaches: circulations of ever more rounds
build up.
"""

from __future__ import annotations

import json

from postproc import cli
from postproc.progress import doing
from postproc.theory import tricritical
from postproc.theory.circuit import PAPERS_AGE
from postproc.theory.models import MODELS, describe
from postproc.theory.options import circuit_options, given_circuit


def main(arguments: list[str] | None = None) -> int:
    """Print the theory of one circuit as JSON."""
    options = circuit_options("theory", __doc__)
    options.add_argument(
        "--tricritical", action="store_true", help="where the transition turns into a jump"
    )
    options.add_argument(
        "--age", type=cli.number(0.0), metavar="A",
        help=f"of the run, for its net current (default: {PAPERS_AGE:g}, that of the paper's runs)",
    )  # fmt: skip
    given = options.parse_args(arguments)
    circuit, model = given_circuit(given), MODELS[given.model]
    if given.age is not None and not model.aged:
        aged = " or ".join(name for name, one in MODELS.items() if one.aged)
        raise cli.InputError(f"--age is of --model {aged}")
    with doing(f"theory {given.model}"):
        answer = describe(circuit, model)
    if given.tricritical:
        if not model.mixed:
            mixed = " or ".join(name for name, one in MODELS.items() if one.mixed)
            raise cli.InputError(f"--tricritical is of --model {mixed}")
        there = tricritical.tricritical(model.of(circuit))
        answer["transition"] = tricritical.order(model.of(circuit))
        answer["tricritical"] = vars(there) if there else None
    print(json.dumps(answer, indent=2))
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))
