"""Where the one-channel model loses its homogeneous state, J. Phys. A 53, 305001 (2020).

- planes: chi over two of l, w, r and T, all six pairs, N = 1000 and 10,000: picture, transitions;
- load: chi against N w l/(8 T A) at finer steps (25 s), at N = 10,000 from chi(0) = 0, 0.5 and 1.

Quick planes have ten values of each key.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import postproc
from postproc.theory.circuit import Circuit
from studies.common import study
from studies.common.numbers import mean_of
from studies.one_channel import picture
from studies.one_channel.picture import KEYS, Plane

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import xarray as xr

NUMBERS = (1000, 10000)
LENGTHS = {"channel1_length": (0.2, 0.8), "channel1_width": (0.2, 0.8), "urn_radius": (0.8, 1.5)}
SIZES = {"channel1_length": 0.5, "channel1_width": 0.5, "channel2_width": 0.0}  # of `plane.nml`


def circuit_of(number: int) -> Circuit:
    """Return the circuit of `plane.nml` with N particles; T/N is the same for each."""
    return Circuit(number, number // 100, **SIZES)


def run_plane(work: study.Study, number: int, keys: tuple[str, str]) -> Path:
    """Run a plane over two of `KEYS`; return the results file."""
    many = int(work.pick(10, 50))
    ranges = {key: [*ends, many] for key, ends in LENGTHS.items()}
    unit = number // 1000  # T is whole
    ranges["threshold"] = [4 * unit, 22 * unit, int(work.pick(10, 19 if unit == 1 else 46))]
    changes = {
        "table": {key: None for key in keys if key in SIZES},
        "particles": {"number": number},
        "gate": {"threshold": None if "threshold" in keys else number // 100},
        "scan": {f"{key}_range": ranges[key] for key in keys},
    }
    return work.run("plane", f"{keys[0]}_{keys[1]}_{number}", changes)


def plane_of(data: xr.Dataset, circuit: Circuit, keys: tuple[str, str]) -> Plane:
    """Return what was measured over two of `KEYS`."""
    chi = data.chi.mean("replica").transpose(keys[1], keys[0]).to_numpy()
    start = abs(2.0 * float(data.urn1_number) / circuit.number - 1.0)
    x, y = (data[key].to_numpy().astype(float) for key in keys)
    return Plane(circuit, keys, x, y, chi, start)


def planes(work: study.Study) -> None:
    """Draw all planes, and print their transitions."""
    found = [
        plane_of(postproc.open_results(run_plane(work, number, keys)), circuit_of(number), keys)
        for number in NUMBERS for keys in combinations(KEYS, 2)
    ]  # fmt: skip
    print(picture.table(found))
    work.draw(picture.figure(found), "one_channel")


def text_of(chi: Sequence[float]) -> str:
    """Return mean and standard error of replicas as text."""
    return "{:.4g} +- {:.2g}".format(*mean_of(chi))


def load(work: study.Study) -> None:
    """Print chi against N w l/(8 T A), one value for each start."""
    for name in ("load", "starts"):
        data = postproc.open_results(work.run(name, name))
        for length in data.channel1_length.to_numpy():
            chi = data.chi.sel(channel1_length=length).transpose(..., "replica").to_numpy()
            circuit = Circuit(int(data.number), int(data.threshold),
                              **{**SIZES, "channel1_length": float(length)})  # fmt: skip
            text = " and ".join(map(text_of, chi.reshape(-1, chi.shape[-1])))
            print(f"N = {circuit.number}, {picture.relative_load(circuit):.3f}: {text}")


PARTS = (planes, load)

if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, {part.__name__: part for part in PARTS}))
