"""Errors of single trajectories: against cost, against time, and after time reversal.

The probes (make probes) run in single, double and quadruple precision, into
build/trajectories/quick, or full (minutes); existing answers are not computed again.
"""

from __future__ import annotations

from studies.common import study
from studies.trajectories import growth, reversal


def run(work: study.Study) -> None:
    """Run particles in every engine and precision, then forwards and back."""
    growth.run(work)
    reversal.run(work)


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))
