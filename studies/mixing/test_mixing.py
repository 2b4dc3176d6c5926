"""Mixing: chains whose urns are well mixed, and chains whose sparse urn holds back."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest

from postproc import cli
from postproc.reading.results import FLOWS, Results, Series
from postproc.tests.runs import BARE, FORGETFUL, results_of
from postproc.theory.chain import passage_times
from postproc.theory.circuit import Circuit, flow1, flow2, half2_number
from postproc.theory.renewal import RENEWAL
from studies.mixing import study as mixing

if TYPE_CHECKING:
    from pathlib import Path

CIRCUIT = Circuit(400, 1, gate=RENEWAL)
INTERVAL, STEPS = 25.0, 100  # of the series; steps of the chain within one


def _chains(
    kept: tuple[float, float], replicas: int = 200, intervals: int = 60, burst: int = 1
) -> list[Series]:
    """Return series of chains from chi = 1, the sparse urn's outflows times `kept`.

    The sparse urn's crossings of channel 1 come `burst` at a time.
    """
    random, total, step = np.random.default_rng(11), int(CIRCUIT.number), INTERVAL / STEPS
    everyone = np.arange(total + 1)
    through = np.array([flow1(CIRCUIT, everyone), flow2(CIRCUIT, everyone)])
    first = np.full(replicas, total)
    numbers, flows = [], []
    for _ in range(intervals):
        counts = np.zeros((4, replicas))
        for _ in range(STEPS):
            means = np.array(
                [
                    through[0, first],
                    through[0, total - first],
                    through[1, first],
                    through[1, total - first],
                ]
            )
            sparse_first = 2 * first < total
            for at, factor in ((0, kept[0]), (2, kept[1])):
                means[at, sparse_first] *= factor
                means[at + 1, ~sparse_first] *= factor
            bursts = np.ones((4, replicas))
            bursts[0, sparse_first] = bursts[1, ~sparse_first] = burst
            jumps = bursts * random.poisson(means * step / bursts)
            counts += jumps
            change = jumps[1] + jumps[3] - jumps[0] - jumps[2]
            first = np.clip(first + change, 0, total).astype(int)
        numbers.append(first)
        flows.append(counts / INTERVAL)
    time = INTERVAL * np.arange(1, intervals + 1)
    return [
        Series(
            time,
            np.array(numbers, float)[:, one],
            dict(zip(FLOWS, np.array(flows)[:, :, one].T, strict=True)),
        )
        for one in range(replicas)
    ]


@cache
def _counts(kept: tuple[float, float], burst: int) -> mixing.Counts:
    parts = [mixing.polarised_counts(CIRCUIT, one) for one in _chains(kept, burst=burst)]
    return mixing.Counts(
        np.concatenate([part.measured for part in parts], axis=1),
        np.concatenate([part.expected for part in parts], axis=1),
    )


@pytest.mark.parametrize("kept", [(1.0, 1.0), (0.8, 0.5)])
def test_what_the_sparse_urn_keeps_back_is_found(kept: tuple[float, float]) -> None:
    counts = _counts(kept, 1)
    ratio = dict(zip(mixing.OUTFLOWS, counts.ratio(), strict=True))
    errors = dict(zip(mixing.OUTFLOWS, 5.0 / np.sqrt(counts.measured.sum(axis=1)), strict=True))
    assert ratio["sparse1"] == pytest.approx(kept[0], abs=errors["sparse1"])
    assert ratio["sparse2"] == pytest.approx(kept[1], abs=errors["sparse2"])
    assert ratio["dense1"] == pytest.approx(1.0, abs=errors["dense1"])
    assert ratio["dense2"] == pytest.approx(1.0, abs=errors["dense2"])


@pytest.mark.parametrize("burst", [1, 3])
def test_scatter_is_one_by_chance_and_the_size_of_bursts(burst: int) -> None:
    counts = _counts((1.0, 1.0), burst)
    scatter = dict(zip(mixing.OUTFLOWS, counts.scatter(), strict=True))
    error = 5.0 * math.sqrt(2.0 / counts.measured.shape[1])
    assert scatter["sparse1"] == pytest.approx(burst, abs=burst * error)
    assert scatter["dense2"] == pytest.approx(1.0, abs=error)


def test_intervals_count_until_the_state_is_left_and_not_after() -> None:
    first = np.array([380.0, 370.0, 230.0, 390.0, 390.0])  # chi = 0.9, 0.85, 0.15, then back
    flows = {name: np.arange(5.0) * (at + 1) for at, name in enumerate(FLOWS)}
    series = Series(INTERVAL * np.arange(1.0, 6.0), first, flows)
    counts = mixing.polarised_counts(CIRCUIT, series)
    expected = INTERVAL * np.outer([1, 2, 3, 4], [1.0, 2.0])  # urn 1 is the dense one
    assert counts.measured == pytest.approx(expected)
    mirrored = Series(series.time, 400.0 - first, flows)
    swapped = mixing.polarised_counts(CIRCUIT, mirrored)
    assert swapped.measured == pytest.approx(expected[[1, 0, 3, 2]])
    assert swapped.expected == pytest.approx(counts.expected)
    assert counts.expected[3, 0] == pytest.approx(
        0.5 * INTERVAL * float(flow2(CIRCUIT, 20.0) + flow2(CIRCUIT, 30.0))
    )


@pytest.mark.parametrize("number", [40, 41])
def test_a_chain_that_holds_back_solves_the_linear_equations(number: int) -> None:
    circuit = Circuit(number, 2, channel1_length=8.0)
    everyone = np.arange(number + 1)
    sparse = 2 * everyone < number
    out = np.where(sparse, 0.8, 1.0) * flow1(circuit, everyone)
    out += np.where(sparse, 0.5, 1.0) * flow2(circuit, everyone)
    up, down = out[::-1], out  # of N2
    generator = np.diag(up[:-1], 1) + np.diag(down[1:], -1) - np.diag(up + down)
    spread = np.abs(2.0 * everyone - number) / number
    right = (spread > 0.2) & (2 * everyone > number)
    for inside, start, at in ((spread < 0.7, number // 2, 0), (right, number, 1)):
        times = np.linalg.solve(generator[np.ix_(inside, inside)], -np.ones(inside.sum()))
        expected = times[np.flatnonzero(inside).tolist().index(start)]
        found = passage_times(circuit, 0.2, 0.7, (0.8, 0.5))[at]
        assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("occupation", [False, True])
def test_flows_are_expected_at_what_the_halves_hold(occupation: bool) -> None:
    circuit = replace(CIRCUIT, number=180, threshold=2, channel1_length=4.0, occupation=occupation)
    shares = np.array([20.0, 160.0])
    halves = half2_number(circuit, shares)
    first = np.full(3, halves[1])
    flows = dict.fromkeys(FLOWS, np.ones(3))
    counts = mixing.polarised_counts(circuit, Series(INTERVAL * np.arange(1.0, 4.0), first, flows))
    sparse, dense = flow1(circuit, shares)
    assert counts.expected[1] == pytest.approx(INTERVAL * sparse, rel=1e-3)
    assert counts.expected[0] == pytest.approx(INTERVAL * dense, rel=1e-3)
    if occupation:
        assert halves[0] != pytest.approx(shares[0], rel=1e-2)


def test_runs_are_measured_and_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scan = {"threshold": 1, "urn1_fraction": [0.5, 1.0], "replicas": 4}
    run = {"duration": 3000.0, **FORGETFUL}
    output = {"series_interval": 3.0, "snapshot_times": None}
    path = results_of(
        tmp_path / "run.h5", particles={"number": 400}, run=run, scan=scan, output=output
    )
    with Results(path) as results:
        (paper,) = mixing.mixing([results], {"gate": RENEWAL, "occupation": True})
    assert paper.ratio["dense2"] == pytest.approx(1.0, abs=0.05)
    assert paper.ratio["sparse1"] == pytest.approx(1.0, abs=0.05)
    assert paper.intervals == 4 * 999
    assert math.isnan(paper.removed(paper.chain_less))  # nothing passed
    assert cli.run(mixing.main, [str(path), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["removed_less"] is None
    assert row["chain_less"] < row["chain"] < paper.chain
    assert cli.run(mixing.main, [str(path)]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_share_of_the_logarithm_that_is_removed(tmp_path: Path) -> None:
    particles = {"number": 900, "urn1_number": 900}
    path = results_of(tmp_path / "run.h5", particles=particles, scan={"threshold": 18})
    with Results(path) as results:
        (one,) = mixing.mixing([results], {})
    time = one.lifetime.time
    made = replace(one, chain=100.0 * time)
    assert made.removed(10.0 * time) == pytest.approx(0.5)
    assert made.removed(time) == pytest.approx(1.0)
    assert math.isnan(replace(one, chain=1.5 * time).removed(time))


def test_files_that_do_not_serve(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    urn = results_of(tmp_path / "urn.h5", table={"shape": "urn"})
    even = results_of(tmp_path / "even.h5")
    bare = results_of(tmp_path / "bare.h5", particles={"urn1_number": 1000}, output=BARE)
    for path in (urn, even, bare):
        assert cli.run(mixing.main, [str(path)]) == 2
        assert capsys.readouterr().err.count("\n") == 1
