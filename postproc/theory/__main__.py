"""What a theory says of one circuit, as JSON: stationary states, transition.

Options are named like the keys of the namelist; lengths are over the speed v = 1. The net current
of two_port and direction includes what circulates, which is told as well. These two count
particles in the channels always. With --tricritical, of window and renewal: where on their
line of transition a jump turns into a continuous one, at this T, w, l and r, and which of the two
the transition is at this N.
"""

from __future__ import annotations

import json

from postproc import cli
from postproc.theory import tricritical
from postproc.theory.models import MODELS, describe
from postproc.theory.options import circuit_options, given_circuit

MIXED = ("window", "renewal")  # models whose urns are well mixed


def main(arguments: list[str] | None = None) -> int:
    """Print the theory of one circuit as JSON."""
    options = circuit_options("theory", __doc__)
    options.add_argument(
        "--tricritical", action="store_true", help="where the transition turns into a jump"
    )
    given = options.parse_args(arguments)
    circuit, model = given_circuit(given), MODELS[given.model]
    told = describe(circuit, model)
    if given.tricritical:
        if given.model not in MIXED:
            raise cli.InputError(f"--tricritical is of --model {' or '.join(MIXED)}")
        there = tricritical.tricritical(model.of(circuit)[0])
        told["transition"] = tricritical.order(model.of(circuit)[0])
        told["tricritical"] = vars(there) if there else None
    print(json.dumps(told, indent=2))
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))
