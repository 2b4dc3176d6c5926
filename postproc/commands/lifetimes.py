"""Prints, as JSON, mean lifetimes of the homogeneous and the polarised state of a circuit.

At finite N, N2 is a birth-death chain with the theory's rates. A particle goes from urn 1 to urn 2
at rate f(N - N2)/(pi A) and back at rate f(N2)/(pi A), whose difference is eta. If both kinds of
state are stable (T = 2 in the paper), a state is left by fluctuations; its lifetime is the mean
time from the state to the unstable one between them; a state that is not stable has 0. Of two
polarised states it is the outer one. Figure lifetimes and the page on theory count from chi = 0
until 0.7 and from chi = 1 until 0.2: so counted those of direction are within a factor of 2.3 of
runs for T = 1 and 2 at w = 0.3 and w' = 0.01, and up to 3.5 times too short at T = 1 and w = 1.2.
At larger T they are too long, 14 and 22 times at T = 5, N = 1000, w' = 0.0281: the chain takes
crossings as independent, but there particles get through a gate in bursts.
"""

from __future__ import annotations

import json

from postproc import cli
from postproc.commands.circuit_options import beside, circuit_options, given_circuit, given_models
from postproc.progress import doing


def main(arguments: list[str] | None = None) -> int:
    """Print the lifetimes of one circuit as JSON (null: it is never left)."""
    given = circuit_options("lifetimes", __doc__).parse_args(arguments)
    circuit = given_circuit(given)
    if not circuit.alike:
        raise cli.InputError("a chain of lifetimes needs two equal urns and gates")
    models, answers = given_models(given, circuit), []
    for model in models:
        with doing(f"lifetimes, theory {model.name}"):
            answers.append(cli.finite(vars(model.lifetimes(circuit))))
    print(json.dumps(beside(models, answers), indent=2))
    return 0
