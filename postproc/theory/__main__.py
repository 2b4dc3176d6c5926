"""What a theory says of one circuit, as JSON: stationary states, transition.

Options are named like the keys of the namelist; lengths are over the speed v = 1. The net current
of two_port and direction includes what circulates, which is told as well. These two count
particles in the channels always. With --tricritical, of window and renewal: where on their
line of transition a jump turns into a continuous one, at this T, w, l and r, and which of the two
the transition is at this N. With --age, of two_port: the net current of a run of that age, in the
most polarised stable state. Circulations of more rounds than fit into it are left out.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from postproc import cli
from postproc.progress import doing
from postproc.theory import tricritical, two_port
from postproc.theory.models import MODELS, describe
from postproc.theory.options import circuit_options, given_circuit

if TYPE_CHECKING:
    from collections.abc import Sequence

    from postproc.theory.circuit import Circuit

MIXED = ("window", "renewal")  # models whose urns are well mixed


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
        told = describe(circuit, model)
    if given.tricritical:
        if given.model not in MIXED:
            raise cli.InputError(f"--tricritical is of --model {' or '.join(MIXED)}")
        there = tricritical.tricritical(model.of(circuit)[0])
        told["transition"] = tricritical.order(model.of(circuit)[0])
        told["tricritical"] = vars(there) if there else None
    if given.age is not None:
        if given.model != "two_port":
            raise cli.InputError("--age is of --model two_port")
        told["by_age"] = by_age(model.of(circuit)[0], given.age)
    print(json.dumps(told, indent=2))
    return 0


def by_age(circuit: Circuit, ages: Sequence[float]) -> list[dict[str, float]]:
    """Return the net current of runs of each age in the most polarised stable state, if any."""
    stable = [one for one in two_port.stationary_states(circuit) if one.kind == "stable"]
    if not stable:
        return []
    state = max(stable, key=lambda one: one.mass_spread)
    around = two_port.circulating_at(circuit, state.urn2_number, ages)
    rest = state.net_current - (state.circulating_current or 0.0)
    return [{"age": age, "net_current": rest + float(one)}
            for age, one in zip(ages, around, strict=True)]  # fmt: skip


if __name__ == "__main__":
    raise SystemExit(cli.run(main))
