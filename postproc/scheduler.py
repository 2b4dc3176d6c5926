"""Simulation of an ensemble on many ranks: its scheduling of tasks, event by event.

Every free rank takes a task from the task queue in the memory of rank 0: one atomic operation
returns the next position in the list, another reads the task there, others count finished tasks.
The queue serves one operation at a time (`service`), and each message takes some time (`latency`).
A running task reads the queue every 0.1 s, or less often: all ranks together read it at most 10 000
times a second, and for at most half a percent of their time. `mpirun -n RANKS build/bin/bench
board` measures both numbers.

Prints, as JSON, how the ranks spend their time; with `--figure`, draws the idle share against the
number of tasks, for three ways of scheduling, and against the length of a task.
"""

from __future__ import annotations

import json
from dataclasses import asdict

from postproc import cli
from postproc.figures import style
from postproc.speed.scheduler import ORDERS, Network, draw, run_order, task_lengths


def main(arguments: list[str] | None = None) -> int:
    """Simulate one run and print it; draw the figure if requested."""
    options = cli.parser("scheduler", __doc__)
    options.add_argument(
        "--ranks", type=cli.integer(1, 10**7), default=10_000, help="default: 10000"
    )
    options.add_argument(
        "--tasks", type=cli.integer(1, 10**8), default=1_000_000, help="default: 1000000"
    )
    options.add_argument(
        "--seconds", type=cli.number(1e-12, 1e12), default=1.0, help="mean length of a task (1)"
    )
    options.add_argument(
        "--spread",
        type=cli.number(0.0, 100.0),
        default=0.3,
        help="standard deviation of the lengths over the mean",
    )
    options.add_argument(
        "--foresight",
        type=cli.number(0.0, 100.0),
        default=0.1,
        help="relative error of the expected lengths (0.1)",
    )
    options.add_argument("--order", choices=ORDERS, default="longest", help="default: longest")
    for key, low, default in (
        ("latency", 0.0, Network.latency),
        ("service", 1e-12, Network.service),
    ):
        options.add_argument(
            f"--{key}",
            type=cli.number(low, 1e6),
            default=default,
            help=f"seconds ({default:g})",
        )
    options.add_argument("--seed", type=cli.integer(0, 2**63 - 1), default=1)
    options.add_argument("--figure", action="store_true", help="draw as well")
    cli.add_output(options)
    chosen = options.parse_args(arguments)
    network = Network(chosen.latency, chosen.service)
    lengths = task_lengths(chosen.tasks, chosen.seconds, chosen.spread, chosen.seed)
    found = run_order(lengths, chosen.ranks, network, chosen.order, chosen.foresight)
    print(json.dumps({"ranks": chosen.ranks, "tasks": chosen.tasks, **asdict(found)}, indent=2))
    if chosen.figure:
        made = draw(
            chosen.ranks, chosen.tasks, chosen.seconds, chosen.spread, chosen.foresight, network
        )
        style.save(made, chosen.output, "scheduler")
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))
