"""Measures theories against runs: errors of chi and of the currents, and of the phase.

Prints a table, or JSON with `--json`, for the theories of well mixed urns, by name: the paper's
window, the renewal gate, and the renewal gate with particles in the channels counted. A point
counts as polarised if chi exceeds 0.15. Differences of chi are taken at all points where the
measurement is polarised, the same for every theory (of two stable states the nearer one is taken),
and again at those of them on the side of the upper transition, where T is larger than at the
largest chi; those of the net current where the theory is polarised too. For the single urn only its
current is compared, relative to theory, where that exceeds a hundredth of the free current.

Then, to find the origin of the rest, the four flows of polarised circuits, summed over points,
relative to those of the theory at the measured spread: out of the dense and of the sparse urn,
through channel 1 (where the gates' formula matters) and 2 (where only the mixing in the urns does).
"""

from __future__ import annotations

import json
import math
from pathlib import Path

from postproc import cli
from postproc.reading.results import opened
from postproc.report.compare import FLOWS, compare


def main(arguments: list[str] | None = None) -> int:
    """Print the differences of each theory from the runs."""
    options = cli.parser("compare", __doc__)
    options.add_argument("files", metavar="FILE.h5", type=Path, nargs="+")
    cli.add_verify(options)
    options.add_argument("--json", action="store_true", help="print JSON")
    given = options.parse_args(arguments)
    with opened(given.files, verify=given.verify) as files:
        found = compare(files)
        for results in files:
            results.say_if_partial()
    if given.json:
        print(json.dumps(cli.finite([vars(one) for one in found]), indent=2))
        return 0
    print(
        f"{'theory':32s} {'points':>6s} {'phase':>7s} {'chi':>9s} {'upper chi':>9s} "
        f"{'current':>9s} {'(error)':>9s}"
    )
    for one in found:
        print(
            f"{one.theory:32s} {one.points:6d} {one.right_phase:7.3f} {one.chi:9.2e} "
            f"{one.upper_chi:9.2e} {one.current:9.2e} {one.measured_chi:9.1e}"
        )
    if all(math.isnan(one.dense2) for one in found):
        return 0
    print("\nflows over those of the theory at the measured spread, polarised circuits")
    print(f"{'':32s} {'channel 1':>17s} {'channel 2':>17s}")
    print(f"{'theory':32s}" + 2 * f" {'dense':>8s} {'sparse':>8s}")
    for one in found:
        print(f"{one.theory:32s}" + "".join(f" {getattr(one, name):8.3f}" for name in FLOWS))
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))
