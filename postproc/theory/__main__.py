"""What a theory says of one circuit, as JSON: stationary states, transition.

Options are named like the keys of the namelist; lengths are over the speed v = 1. The net current of
two_port and direction includes what circulates, which is told as well. These two count particles in
the channels always.
"""

from __future__ import annotations

import json

from postproc import cli
from postproc.theory.models import MODELS, describe
from postproc.theory.options import circuit_options, given_circuit


def main(arguments: list[str] | None = None) -> int:
    """Print the theory of one circuit as JSON."""
    given = circuit_options("theory", __doc__).parse_args(arguments)
    print(json.dumps(describe(given_circuit(given), MODELS[given.model]), indent=2))
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))
