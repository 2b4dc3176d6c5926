"""Errors of single trajectories: against their cost, growing in time, and there and back.

The probes (make probes) are asked in single, double and quadruple precision, into
build/trajectories/quick, or full (minutes); an answer that is there is not asked for again.
"""

from __future__ import annotations

from postproc import study
from studies.trajectories import growth, reversal


def run(work: study.Study) -> None:
    """Follow particles in every engine and precision, then there and back."""
    growth.run(work)
    reversal.run(work)


if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, run))
