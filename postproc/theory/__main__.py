"""Results of a theory for one circuit, as JSON: stationary states, transition.

Options are named like the keys of the namelist; lengths are over the speed v = 1. The net current
of two_port and direction includes circulation, which is printed as well. All except window and
renewal always count particles in the channels. With --tricritical, for theories of well mixed urns:
the point on the line of transition at which a jump becomes continuous, at this T, w, l and r, and
which of the two the transition is at this N. With --age, for two_port and direction: the net
current of a run of that age, in the most polarised stable state. Circulations of more rounds than
fit into it are left out.
"""

from __future__ import annotations

import json

from postproc import cli
from postproc.progress import doing
from postproc.theory import tricritical
from postproc.theory.models import MODELS, describe
from postproc.theory.options import circuit_options, given_circuit


def main(arguments: list[str] | None = None) -> int:
    """Print the theory of one circuit as JSON."""
    options = circuit_options("theory", __doc__)
    options.add_argument(
        "--tricritical", action="store_true", help="where the transition turns into a jump"
    )
    options.add_argument(
        "--age", type=cli.number(0.0), nargs="+", metavar="A", help="of a run, one or several"
    )
    given = options.parse_args(arguments)
    circuit, model = given_circuit(given), MODELS[given.model]
    with doing(f"theory {given.model}"):
        answer = describe(circuit, model)
    if given.tricritical:
        if not model.mixed:
            mixed = " or ".join(name for name, one in MODELS.items() if one.mixed)
            raise cli.InputError(f"--tricritical is of --model {mixed}")
        there = tricritical.tricritical(model.of(circuit))
        answer["transition"] = tricritical.order(model.of(circuit))
        answer["tricritical"] = vars(there) if there else None
    if given.age is not None:
        if model.by_age is None:
            aged = " or ".join(name for name, one in MODELS.items() if one.by_age)
            raise cli.InputError(f"--age is of --model {aged}")
        answer["by_age"] = model.by_age(model.of(circuit), given.age)
    print(json.dumps(answer, indent=2))
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))
