"""Makes files of results from a quick stochastic model: memoryless urns that obey the theory."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

import h5py
import numpy as np

from postproc.seal import seal_of
from postproc.theory import Circuit, flow1, flow2, single_urn_current

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

NAMELIST = """&table
  shape = '{shape}'
  urn_radius = 1.0
  channel1_width = 0.3
/
&particles
  number = {number}
  urn1_number = {start}
/
&run
  duration = {duration}
/
&output
  series_interval = {interval}
/
"""


def fabricate(
    path: Path,
    points: list[dict[str, float]],
    replicas: int = 2,
    duration: float = 4000.0,
    interval: float = 10.0,
    snapshots: int = 3,
    incomplete: int = 0,
    shape: str = "circuit",
) -> Path:
    """Write results for `points` (fields of `Circuit`, and `urn1_number`) to `path`.

    `incomplete` tasks at the end have no results; `interval` 0 leaves the series out, and
    `snapshots` 0 the snapshots.
    """
    random = np.random.default_rng(5)
    steps = int(duration / interval) if interval else 400
    width = interval or duration / steps
    points = [{**point, "threshold": int(point.get("threshold", 7))} for point in points]
    run = _run if shape == "circuit" else _run_urn
    runs = [[run(point, steps, width, random) for _ in range(replicas)] for point in points]
    with h5py.File(path, "w") as file:
        _attributes(file, _full(points[0]), (duration, interval), incomplete, shape)
        _dimensions(file, len(points), replicas)
        for name in ("number", "threshold", "channel1_width", "channel2_width", "urn1_number"):
            _dataset(file, name, np.array([_full(point)[name] for point in points]), ("point",))
        _averages(file, runs, width, incomplete)
        if interval:
            _series(file, runs, width)
        if snapshots:
            _snapshots(file, runs, points, snapshots, random)
    seal(path)
    return path


def seal(path: Path) -> None:
    """Put the seal behind a file that h5py has written; h5py takes an old one away."""
    content = path.read_bytes()
    path.write_bytes(content + seal_of(len(content), hashlib.sha256(content).hexdigest()))


def _full(point: dict[str, float]) -> dict[str, float]:
    full = {"number": 1000, "threshold": 7, "channel1_width": 0.3, "channel2_width": 0.01, **point}
    return {"urn1_number": full["number"] // 2, **full}


def _run(
    point: dict[str, float], steps: int, width: float, random: np.random.Generator
) -> dict[str, NDArray[np.float64]]:
    full = _full(point)
    first, total = int(full.pop("urn1_number")), int(full["number"])
    circuit = Circuit(**full)
    everyone = np.arange(total + 1)
    through1, through2 = flow1(circuit, everyone), flow2(circuit, everyone)
    numbers, flows = np.empty(steps), np.empty((4, steps))
    for step in range(steps):
        second = total - first
        means = (through1[first], through1[second], through2[first], through2[second])
        counts = random.poisson(np.array(means) * width)
        first = int(np.clip(first + counts[1] + counts[3] - counts[0] - counts[2], 0, total))
        numbers[step], flows[:, step] = first, counts / width
    return {"urn1_number": numbers, "flows": flows, "number": total}


def _run_urn(
    point: dict[str, float], steps: int, width: float, random: np.random.Generator
) -> dict[str, NDArray[np.float64]]:
    full = _full(point)
    number = int(full["number"])
    current = single_urn_current(number, full["threshold"], full["channel1_width"])
    flows = np.zeros((4, steps))
    flows[0] = random.poisson(current * width, steps) / width
    return {"urn1_number": np.full(steps, number), "flows": flows, "number": number, "urn": True}


def _attributes(
    file: h5py.File,
    point: dict[str, float],
    times: tuple[float, float],
    incomplete: int,
    shape: str,
) -> None:
    text = NAMELIST.format(
        number=point["number"],
        start=point["urn1_number"],
        duration=times[0],
        interval=times[1],
        shape=shape,
    )
    values = {
        "program": "battery",
        "version": "0.1.0",
        "git_commit": "0123456",
        "compiler": "none",
        "compiler_options": "",
        "mpi_library": "none",
        "mpi_ranks": 2,
        "namelist": text,
        "initial_file_fingerprint": "",
        "created": "2026-01-01T00:00:00Z",
        "status": "partial" if incomplete else "complete",
    }
    for name, value in values.items():
        file.attrs[name] = np.bytes_(value) if isinstance(value, str) and value else value


def _dimensions(file: h5py.File, points: int, replicas: int) -> None:
    for name, size in (("point", points), ("replica", replicas)):
        file[name] = np.arange(1, size + 1)
        file[name].make_scale(name)


def _dataset(
    file: h5py.File | h5py.Group, name: str, data: NDArray[np.float64], axes: tuple[str, ...]
) -> None:
    made = file.create_dataset(name, data=data)
    made.attrs["units"], made.attrs["long_name"] = "1", name
    for axis, scale in enumerate(axes):
        made.dims[axis].attach_scale(file.file[scale])


def _averages(
    file: h5py.File, runs: list[list[dict[str, NDArray[np.float64]]]], width: float, incomplete: int
) -> None:
    shape = (len(runs), len(runs[0]))
    names = ("chi", "current1", "current2", "flow1_12", "flow1_21", "flow2_12", "flow2_21")
    values = {name: np.empty(shape) for name in names}
    errors = {name: np.empty(shape) for name in names[:3]}
    for index in np.ndindex(shape):
        run = runs[index[0]][index[1]]
        late = slice(run["urn1_number"].size // 2, None)
        chi = np.abs(2 * run["urn1_number"][late] - run["number"]) / run["number"]
        chi = np.full_like(chi, np.nan) if run.get("urn") is not None else chi
        flows = run["flows"][:, late]
        for name, series in zip(
            names, (chi, flows[0] - flows[1], flows[2] - flows[3], *flows), strict=True
        ):
            values[name][index] = series.mean()
            if name in errors:
                blocks = np.array(
                    [block.mean() for block in np.array_split(series, min(10, series.size))]
                )
                errors[name][index] = blocks.std() / np.sqrt(10)
    values |= {f"{name}_error": error for name, error in errors.items()}
    values["chi_collision"] = np.full(shape, np.nan)
    values["collisions"] = np.full(shape, 1e7)
    values["bounce_backs"] = np.full(shape, 1e4)
    values["time"] = np.full(shape, width * runs[0][0]["urn1_number"].size)
    values["cpu_seconds"] = np.full(shape, 0.5)
    values["task_status"] = np.zeros(shape)
    values["seed"] = np.arange(1.0, 1.0 + np.prod(shape)).reshape(shape)
    for name, value in values.items():
        flat = value.astype(float).reshape(-1)
        if incomplete:
            flat[-incomplete:] = 2 if name == "task_status" else np.nan
        _dataset(file, name, flat.reshape(shape), ("point", "replica"))


def _series(
    file: h5py.File, runs: list[list[dict[str, NDArray[np.float64]]]], width: float
) -> None:
    group = file.create_group("series")
    steps = runs[0][0]["urn1_number"].size
    group["time"] = width * np.arange(steps + 1)
    group["time"].make_scale("time")
    axes = ("point", "replica", "series/time")
    first = np.array([[r["urn1_number"][[0, *range(steps)]] for r in p] for p in runs])
    _dataset(group, "urn1_number", first, axes)
    for at, name in enumerate(("flow1_12", "flow1_21", "flow2_12", "flow2_21")):
        flows = np.array([[np.append(0.0, r["flows"][at]) for r in p] for p in runs])
        _dataset(group, name, flows, axes)


def _snapshots(
    file: h5py.File,
    runs: list[list[dict[str, NDArray[np.float64]]]],
    points: list[dict[str, float]],
    count: int,
    random: np.random.Generator,
) -> None:
    group = file.create_group("snapshots")
    group["time"] = np.linspace(0.0, 10.0, count)
    group["time"].make_scale("time")
    most = max(int(run[0]["number"]) for run in runs)
    states = np.full((4, len(runs), len(runs[0]), count, most), np.nan)
    for point, replica, at in np.ndindex(states.shape[1:4]):
        run = runs[point][replica]
        when = -1 if at == count - 1 else at * run["urn1_number"].size // count
        state = scatter(_full(points[point]), int(run["urn1_number"][when]), random)
        states[:, point, replica, at, : state.shape[1]] = state
    for name, state in zip(("x", "y", "ux", "uy"), states, strict=True):
        _dataset(group, name, state, ("point", "replica", "snapshots/time"))


def scatter(
    point: dict[str, float], first: int, random: np.random.Generator
) -> NDArray[np.float64]:
    """Return x, y, ux, uy of particles spread over both halves, a few per cent in the channels."""
    width1, width2 = point["channel1_width"], point["channel2_width"]
    chord1, chord2 = (np.sqrt(1 - width**2 / 4) for width in (width1, width2))
    halves = []
    for side, count in ((-1, first), (1, int(point["number"]) - first)):
        x, y = np.empty(0), np.empty(0)
        while x.size < count:
            u, v = random.uniform(-1.6, 1.6, (2, 4 * count + 100))  # from the centre of the urn
            urn = (u**2 + v**2 < 1) & (u > -chord1) & (u < chord2)
            gate = (u > -0.5 - chord1) & (u <= -chord1) & (np.abs(v) < width1 / 2)
            gate &= random.uniform(size=u.size) < 0.4
            x, y = np.append(x, u[urn | gate]), np.append(y, v[urn | gate])
        halves.append((side * (x[:count] + 0.5 + chord1), y[:count]))
    angle = random.uniform(0, 2 * np.pi, int(point["number"]))
    x, y = np.hstack([half[0] for half in halves]), np.hstack([half[1] for half in halves])
    return np.array([x, y, np.cos(angle), np.sin(angle)])
