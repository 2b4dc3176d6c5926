"""Statements of the paper that need more than one run: numbers that docs/paper.md cites.

Each part makes runs, and prints numbers with standard errors over replicas:

- flows: flow of channel 1 from urn 1 at T = 18, runs of comp05.nml, and theories (5 s);
- slices: chi over T, and current over chi, of paper_slice.nml (15 s);
- single: what eq. (eqapp5) adds to the current of the single urn, by w and T (5 s).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import postproc
from postproc.theory.circuit import Circuit, flow1
from postproc.theory.gates import WINDOW
from postproc.theory.renewal import RENEWAL
from studies.common import geometry, study
from studies.common.numbers import mean_of
from studies.common.study import NAMELISTS

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

POLARISED = 0.3  # chi above which a state is called so


def plain(width: float) -> float:
    """Return the flow of channel 2 at chi = 1 between well mixed urns, N = 1000, w = 0.3."""
    return 1000.0 * width / (math.pi * geometry.urn_area(width))


def mean(values: np.ndarray) -> str:
    """Return mean and standard error of replicas as text."""
    return "{:.4g} +- {:.2g}".format(*mean_of(values))


def of_namelist(work: study.Study, name: str) -> xr.Dataset:
    """Run a namelist of `namelists/`; return the results."""
    return postproc.open_results(replace(work, place=NAMELISTS).run(name, name))


def flows(work: study.Study) -> None:
    """Print the flow of channel 1 out of urn 1 at T = 18, by runs and by theories."""
    measured = of_namelist(work, "comp05").flow1_12.sel(threshold=18).to_numpy().ravel()
    window, renewal = (float(flow1(Circuit(1000, 18, gate=gate), 500.0))
                       for gate in (WINDOW, RENEWAL))  # fmt: skip
    print(f"runs {mean(measured)}, window {window:.2f}, renewal gate {renewal:.2f}")


def slices(work: study.Study) -> None:
    """Print chi over T of four w', and current over chi in w' N/(pi A) where chi is above 0.3."""
    data = of_namelist(work, "paper_slice")
    for width in data.channel2_width.to_numpy():
        print(f"w' = {width:g}:")
        for threshold in data.threshold.to_numpy():
            here = data.sel(channel2_width=width, threshold=threshold)
            chi = here.chi.to_numpy().ravel()
            share = here.polarised_current.to_numpy().ravel() / chi / plain(float(width))
            known = f", current over chi {mean(share)}" if chi.mean() > POLARISED else ""
            print(f"  T = {threshold}: chi {mean(chi)}{known}")


def single(work: study.Study) -> None:
    """Print the excess of the paper's current of the single urn over runs, by w and T."""
    data = of_namelist(work, "paper_single_urn")
    for width in data.channel1_width.to_numpy():
        texts = []
        for at, threshold in enumerate(data.threshold.to_numpy()):
            values = data.current1.sel(channel1_width=width)[at].to_numpy()
            circuit = Circuit(1000, int(threshold), float(width), 0.0, gate=WINDOW)
            if values.mean() > 0.0:
                off = float(flow1(circuit, 1000.0)) / values.mean() - 1.0
                texts.append(f"T = {threshold} {100.0 * off:+.2g} %")
        print(f"w = {width:g}: {', '.join(texts)}")


PARTS = (flows, slices, single)

if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, {part.__name__: part for part in PARTS}))
