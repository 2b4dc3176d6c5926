"""Measures the imperfect mixing of the urns, and its effect on the lifetimes of their chain.

Uses series that begin polarised (`lifetimes_*.nml`) as long as they are so. The flows out of either
urn are compared with those of a well mixed one of the same number, with the renewal gate: their
ratio, and the scatter of their counts about that (Fano factor: 1 for independent crossings, more if
they come in bursts, less if they repel each other). Then the polarised state's lifetime by the
chain, unchanged, with the sparse urn's outflow times 0.9, and with its two outflows times the
measured ratios; and the share of the discrepancy's logarithm that each change removes,

    1 - log(changed chain/measured)/log(chain/measured).

Prints a table, or JSON with `--json`. An interval of the series counts if chi has been above 0.2
from the start until the interval begins; chi within the interval does not matter. Particles in the
channels are counted as in the urns, as in the paper, unless `--occupation` is given.
"""

from __future__ import annotations

import json
from pathlib import Path

from postproc import cli
from postproc.reading.results import opened
from postproc.report.mixing import mixing, table
from postproc.theory.renewal import RENEWAL


def main(arguments: list[str] | None = None) -> int:
    """Print the mixing of the urns of runs, and its effect on the chain's lifetimes."""
    options = cli.parser("mixing", __doc__)
    options.add_argument("files", metavar="FILE.h5", type=Path, nargs="+")
    cli.add_verify(options)
    options.add_argument(
        "--occupation", action="store_true", help="tell those in the channels from those in urns"
    )
    options.add_argument("--json", action="store_true", help="print JSON")
    given = options.parse_args(arguments)
    with opened(given.files, verify=given.verify) as files:
        for results in files:
            if results.shape != "circuit":
                raise cli.InputError(f"{results.path}: a run of shape '{results.shape}'")
            results.need_tasks()
        found = mixing(files, {"gate": RENEWAL, "occupation": given.occupation})
        for results in files:
            results.say_if_partial()
    if given.json:
        print(json.dumps(cli.finite([one.row() for one in found]), indent=2))
    else:
        print(table(found))
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))
