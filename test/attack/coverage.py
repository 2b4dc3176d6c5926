"""How often the truth lies within the stated error of a run to a precision.

Many runs with other seeds, each to the same precision, at a battery point, beside a transition and
at a homogeneous point. The mean of all stands for the truth. By hand:
`cd test; ../build/venv/bin/python -m attack.coverage --repeats 200`. It prints for each point how
many replicas were run, and in how many repeats the truth was within one and two stated errors.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from support.program import namelist, run

CASE: dict[str, dict[str, Any]] = {
    "table": {"channel1_width": 0.6},
    "gate": {"threshold": 2},
    "run": {"duration": 2000, "transient_duration": 400},
    "scan": {"channel2_width": "0.01, 0.05, 0.2", "replicas": 16},
    "precision": {
        "chi_replica_error": 0.006,
        "polarised_current_replica_error": 0.005,
        "largest_replicas": 2000,
    },
    "output": {"file": "'out.h5'"},
}
POINTS = ("battery", "beside the transition", "homogeneous")
QUANTITIES = ("chi", "polarised_current")


def measure(folder: Path, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return means and stated errors, (quantity, point), and replicas and status, (2, point)."""
    case = {**CASE, "particles": {"number": 100, "urn1_number": 90, "seed": seed}}
    (folder / "case.nml").write_text(namelist(**case), encoding="utf-8")
    ended = run("--quiet", "--overwrite", "case.nml", folder=folder)
    if ended.returncode != 0:
        raise SystemExit(ended.stdout + ended.stderr)
    with h5py.File(folder / "out.h5") as file:
        means = np.array([np.nanmean(file[name][()], axis=1) for name in QUANTITIES])
        stated = np.array([file[f"{name}_replica_error"][()] for name in QUANTITIES])
        done = (file["task_status"][()] == 0).sum(axis=1)
        return means, stated, np.array([done, file["point_status"][()]])


def main() -> None:
    """Run the repeats and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--repeats", type=int, default=200, help="runs with other seeds")
    repeats = parser.parse_args().repeats
    with tempfile.TemporaryDirectory() as folder:
        found = [measure(Path(folder), seed) for seed in range(1, repeats + 1)]
    means, stated, counts = (np.array(part) for part in zip(*found, strict=True))
    print("| point | quantity | replicas | within 1 | within 2 | other than reached |")
    print("| --- | --- | --- | --- | --- | --- |")
    for p, point in enumerate(POINTS):
        good = counts[:, 1, p] == 0
        replicas = counts[good, 0, p]
        for q, quantity in enumerate(QUANTITIES):
            value = means[good, q, p]
            truth = np.average(value, weights=replicas)
            away = np.abs(value - truth) / stated[good, q, p]
            print(f"| {point} | {quantity} | {replicas.min()} to {replicas.max()} "
                  f"| {100 * np.mean(away < 1):.1f} % | {100 * np.mean(away < 2):.1f} % "
                  f"| {np.count_nonzero(~good)} of {repeats} |")


if __name__ == "__main__":
    main()
