"""What the probabilistic theory says of one circuit, as JSON: eta, stationary states, transition.

Options are named like the keys of the namelist; lengths are over the speed v = 1.
"""

from __future__ import annotations

import json

from postproc import cli
from postproc.theory.options import circuit_options, given_circuit
from postproc.theory.states import describe


def main(arguments: list[str] | None = None) -> int:
    """Print the theory of one circuit as JSON."""
    given = circuit_options("theory", __doc__).parse_args(arguments)
    print(json.dumps(describe(given_circuit(given)), indent=2))
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))
