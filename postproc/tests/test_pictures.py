"""Pictures and reading of results: what is drawn, and what is said of files that cannot be."""

from __future__ import annotations

import base64
import io
import os
import re
import stat
from typing import TYPE_CHECKING

import h5py
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.patches import Circle

from postproc import plot
from postproc.cli import InputError
from postproc.figures import circuits, currents, film, scene, style, theories
from postproc.figures.scene import picture_of
from postproc.reading.groups import Snapshot, series_of, snapshot_of
from postproc.reading.points import alike, mean_error, means, remark, task_of
from postproc.tests.commands import call
from postproc.tests.runs import BARE, edited, leave_out, points_of, results_of
from postproc.theory.circuit import Circuit, eta, flow1, flow2
from postproc.theory.states import stationary_states

if TYPE_CHECKING:
    from pathlib import Path


# the commands that read a file of results, with what comes before it
READERS = [["table"], ["film"], ["report"]]
READERS += [["plot", name] for name in ("flows", "scene", "lifetimes", "phase_diagram")]


@pytest.fixture(scope="module")
def run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "run.h5"
    return results_of(path, scan={"threshold": [7, 18]})


@pytest.mark.parametrize("command", ["flows", "scene"])
def test_pictures_are_written(command: str, run_file: Path, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "folder"
    words = [command, str(run_file), "--point", "0", "--output", str(folder)]
    models = ["--theory", "window", "renewal"]
    assert call("plot", [*words, *models] if command == "flows" else words) == 0
    name = f"run_{command}_point=0"
    assert sorted(path.name for path in folder.iterdir()) == [f"{name}.pdf", f"{name}.png"]
    drawn, paper = ((folder / f"{name}.{kind}").read_bytes() for kind in ("png", "pdf"))
    assert drawn[:5] == b"\x89PNG\r"
    assert paper[:5] == b"%PDF-"
    assert b"/FontFile2" in paper  # its text is text
    width = int.from_bytes(drawn[16:20], "big")
    assert width == round((style.PAGE if command == "scene" else 4.6) * style.RESOLUTION)


def test_flows_of_the_single_urn_are_drawn_alone(tmp_path: Path) -> None:
    """Theories have flows of the circuit: its eta is no line of the urn."""
    points = points_of(results_of(tmp_path / "urn.h5", table={"shape": "urn"}))
    made = circuits.figure_flows(points)
    assert not any("eta" in axes.get_ylabel() for axes in made.axes)
    with pytest.raises(InputError, match="of the circuit, not of the single urn"):
        plot.flows(points, ax=made.axes[0], theory="window")
    assert call("plot", ["flows", str(tmp_path / "urn.h5"), "--theory", "window"]) == 2


def test_currents_show_the_series_the_theory_and_eta(run_file: Path) -> None:
    results = points_of(run_file)
    made = circuits.figure_flows(
        results.isel(point=[0], replica=[1]), theories.named(["window", "renewal"])
    )
    (series,), circuit = series_of(results, 0, 1), results["circuit"].values[0]
    *panels, balance = made.axes
    assert panels[0].get_title("left") == "$N = 1000$, $T = 7$, $w = 0.3$, $w' = 0.01$"
    assert panels[-1].get_xlabel() == "time $t$  (length / $v$)"
    for axes in panels:
        assert axes.get_ylabel() == ("flow (per unit time)" if axes is panels[-1] else "")
        assert axes.get_xlim() == (0.0, 1000.0)
        for container, name in zip(axes.containers, currents.FLOW_LOOK, strict=True):
            assert container.get_label() == currents.FLOW_LOOK[name][2]
            x, y = container.lines[0].get_data()
            assert np.all((x > 0.0) & (x < 1000.0))
            assert y.mean() == pytest.approx(float(series[name].mean()), rel=0.05, abs=1e-3)
        net = [line for line in axes.lines if str(line.get_label()).startswith("net current,")]
        assert [line.get_label() for line in net] == [
            "net current, channel 1, urn 1 → 2",
            "net current, channel 2, urn 2 → 1",
        ]
        one, two = (float(results[f"current{channel}"][0, 1]) for channel in (1, 2))
        assert abs(one) > 0.5
        assert [line.get_ydata().mean() for line in net] == pytest.approx([one, -two], rel=0.1)
        # the paper's state with N2 = 968.7 or its mirror image, as the run chose
        drawn = [line for line in axes.lines if list(line.get_xdata()) == [0, 1]]
        levels = sorted(line.get_ydata()[0] for line in drawn if line.get_linestyle() == "--")
        expected = [flow(circuit, 31.273) for flow in (flow1, flow2)]
        expected += [flow(circuit, 968.727) for flow in (flow1, flow2)]
        expected += [(expected[3] - expected[1]) * np.sign(one)] * 2
        assert levels == pytest.approx(sorted(map(float, expected)), abs=1e-4)
    entries = [text.get_text() for text in made.legends[0].get_texts()]
    assert [one for one in entries if "net currents" in one] == [
        f"{name}: net currents, and $\\eta$ below"
        for name in ("window (the paper's)", "renewal gate")
    ]
    assert balance.get_xlabel() == "$N_2/N$"
    curves = [line.get_data() for line in balance.lines if len(line.get_xdata()) > 2]
    assert len(curves) == 2
    share, flow = curves[0]
    assert flow == pytest.approx(eta(circuit, 1000.0 * share))
    reached = currents.settled_number2(circuit, series) / 1000.0
    marked = [line for line in balance.lines if line.get_markeredgecolor() == style.VERMILION]
    assert reached in [line.get_xdata()[0] for line in marked if len(line.get_xdata())]


def test_the_label_of_flows_stands_beside_their_smallest_numbers(run_file: Path) -> None:
    points = points_of(run_file).isel(point=[0])
    (series,), circuit = series_of(points, 0, 0), points["circuit"].values[0]
    few = {name: 1e-9 * series[name] for name in currents.FLOW_LOOK}
    few["flow1_12"] = few["flow1_12"] + 5.06e-4
    made = style.figure(4.6, 5.4)
    cell = made.add_gridspec(1, 1)[0]
    upper, lower = currents.draw_currents(made, cell, circuit, series.assign(few), (), 500.0)
    made.draw_without_rendering()
    label = lower.yaxis.label.get_window_extent()
    for axes in (upper, lower):
        ticks = [one.get_window_extent() for one in axes.get_yticklabels() if one.get_text()]
        assert ticks
        assert not any(label.overlaps(one) for one in ticks)


def test_theory_has_the_colour_of_what_it_is_meant_for(run_file: Path) -> None:
    results = points_of(run_file)
    made = circuits.figure_flows(results.isel(point=[0], replica=[1]), theories.named(["window"]))
    circuit, (series,) = results["circuit"].values[0], series_of(results, 0, 1)
    second = theories.MODELS["window"].reached(circuit, 1000.0).urn2_number
    if currents.settled_number2(circuit, series) < 500.0:
        second = 1000.0 - second
    colours = {
        line.get_color(): line.get_ydata()[0]
        for line in made.axes[0].lines
        if list(line.get_xdata()) == [0, 1] and line.get_linestyle() == "--"
    }
    assert colours[currents.FLOW_LOOK["flow2_21"][1]] == pytest.approx(flow2(circuit, second))
    assert colours[currents.FLOW_LOOK["flow2_12"][1]] == pytest.approx(
        flow2(circuit, 1000.0 - second)
    )


def test_scene_shows_every_particle_and_counts_those_in_the_gates(run_file: Path) -> None:
    results = points_of(run_file)
    circuit, snapshot = results["circuit"].values[0], snapshot_of(results, 0, 0, -1)
    made = scene.picture_of(circuit, snapshot)
    whole, channel = made.axes
    first = np.count_nonzero(snapshot.x < 0.0)
    for part in ("t = 10", "N = 1000", f"N_1 = {first}", f"N_2 = {1000 - first}"):
        assert f"${part}$" in whole.get_title("center")
    counted = scene.counted_by(circuit, snapshot)
    for gate, place in ((1, "left"), (2, "right")):
        number = np.count_nonzero(counted == gate)
        assert channel.get_title(place) == f"gate {gate}: {number} counted, $T = 7$"
    *free, orange, red = (part.get_offsets().data for part in whole.collections[:4])
    assert len(orange) + len(red) == np.count_nonzero(counted) > 0
    assert [len(part) for part in free] == [
        np.count_nonzero((counted == 0) & (snapshot.x < 0.0)),
        np.count_nonzero((counted == 0) & (snapshot.x > 0.0)),
    ]
    drawn = np.concatenate([*free, orange, red])
    particles = np.column_stack([snapshot.x, snapshot.y])
    assert drawn[np.lexsort(drawn.T)] == pytest.approx(particles[np.lexsort(particles.T)])
    assert channel.get_xlim() == pytest.approx((-0.625, 0.625))
    named = [text.get_text() for text in made.legends[0].get_texts()]
    assert named == [part.get_label() for part in whole.collections[:4]]
    assert "half 1" in named


def test_counts_of_both_gates_of_a_short_channel_are_read() -> None:
    resting = Snapshot(0.0, *np.zeros((4, 1)))
    for length, lines in ((1.0, 1), (0.3, 2)):
        made = picture_of(Circuit(20, 1, channel1_length=length, channel2_width=0.1), resting)
        made.set_dpi(style.RESOLUTION)
        made.draw_without_rendering()
        texts = [one for one in made.axes[1].get_children() if getattr(one, "get_text", str)()]
        told = "\n".join(one.get_text() for one in texts).split("\n")
        assert told == [f"gate {gate}: 0 counted, $T = 1$" for gate in (1, 2)]
        assert len(texts) == 3 - lines
        boxes = [one.get_window_extent() for one in texts]
        assert not boxes[0].overlaps(boxes[-1]) or lines == 2


def _one_line(command: list[str], path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    assert call(command[0], [*command[1:], str(path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert str(path) in error
    return error


@pytest.mark.parametrize("command", READERS)
def test_no_such_file(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "no such file" in _one_line(command, tmp_path / "none.h5", capsys)


@pytest.mark.parametrize("command", READERS)
def test_not_hdf5(command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "text.h5"
    path.write_text("no HDF5 at all\n")
    assert "not an HDF5 file" in _one_line(command, path, capsys)


def test_damaged_file(run_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "half.h5"
    path.write_bytes(run_file.read_bytes()[:5000])
    assert "it has no digest at its end" in _one_line(["plot", "flows"], path, capsys)


@pytest.mark.parametrize("command", READERS)
def test_another_programs_hdf5(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        file["temperature"] = [1.0, 2.0]
    assert "not written by battery" in _one_line(command, path, capsys)


def test_a_folder_is_no_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "is a folder" in _one_line(["plot", "flows"], tmp_path, capsys)


def test_missing_series_and_snapshots(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = results_of(tmp_path / "bare.h5", output=BARE)
    assert "has no series" in _one_line(["plot", "flows"], path, capsys)
    assert "has no snapshots" in _one_line(["plot", "scene"], path, capsys)
    assert "has no snapshots" in _one_line(["film"], path, capsys)
    assert "has no series" in _one_line(["plot", "lifetimes"], path, capsys)


def test_a_series_without_one_of_its_flows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = results_of(tmp_path / "run.h5", run={"duration": 100.0})
    with edited(path) as file:
        del file["series/flow2_12"]
        del file["snapshots/uy"]
    assert "has no series/flow2_12" in _one_line(["plot", "flows"], path, capsys)
    assert "has no snapshots/uy" in _one_line(["plot", "scene"], path, capsys)


def test_a_circuit_is_read_from_values_not_from_the_namelist(tmp_path: Path) -> None:
    table = {"urn_radius": 1.2, "channel1_width": 0.5, "channel1_length": 0.8}
    table |= {"channel2_width": 0.2, "channel2_length": 0.6}
    path = results_of(tmp_path / "run.h5", table=table, output=BARE)
    with edited(path) as file:
        file.attrs["namelist"] = "no namelist"
    assert alike(points_of(path)) == [Circuit(1000, 7, **table, age=500.0)]


@pytest.mark.usefixtures("unwritten")
def test_scatterers_are_drawn_and_no_theory_is_asked(tmp_path: Path) -> None:
    table = {"channel2_width": 0.2, "scatterers": [0.01, 0.0, 0.05, -0.2, 0.1, 0.05]}
    output = {"series_interval": 1.0, "snapshot_times": [5.0, 5.2]}
    path = results_of(tmp_path / "run.h5", table=table, run={"duration": 20.0}, output=output)
    here = [str(path), "--output", str(tmp_path)]
    for name in ("scene", "flows", "model"):
        assert call("plot", [name, *here]) == 0, name
    with pytest.raises(InputError, match="knows scatterers"):
        stationary_states(points_of(path)["circuit"].item())
    results, circuit = points_of(path), points_of(path)["circuit"].item()
    drawn, line = picture_of(circuit, snapshot_of(results, 0, 0, 0)).axes[0], float(circuit.end)
    discs = [patch.center for patch in drawn.patches if isinstance(patch, Circle)]
    # That astride the line is drawn at both ends.
    assert sorted(x for x, _ in discs) == pytest.approx([-line + 0.01, line - 0.2, line + 0.01])


def test_a_film_reads_its_snapshots_at_once(
    run_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One by one each of thousands would unpack a piece of the file that holds hundreds."""
    read, get = [], h5py.Dataset.__getitem__

    def counted(dataset: h5py.Dataset, *which: object, **more: object) -> object:
        read.append(dataset.name)
        return get(dataset, *which, **more)

    results = points_of(run_file)
    single = [snapshot_of(results, 0, 0, k) for k in range(3)]
    monkeypatch.setattr(h5py.Dataset, "__getitem__", counted)
    together = film.read_scenes(results, 0, 0).snapshots
    assert len(together) == len(single) > 1
    for one, other in zip(together, single, strict=True):
        assert one.time == other.time
        for name in ("x", "y", "ux", "uy"):
            assert np.array_equal(getattr(one, name), getattr(other, name)), name
    assert read.count("/snapshots/x") == 1


def test_no_such_task(run_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("plot", ["flows", str(run_file), "--point", "9"]) == 2
    assert "point 9 is not one of 0 to 1" in capsys.readouterr().err


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_folder_that_cannot_be_written(
    run_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tmp_path.chmod(stat.S_IRUSR | stat.S_IXUSR)
    assert call("plot", ["flows", str(run_file), "--output", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.usefixtures("unwritten")
def test_a_partial_run_is_drawn_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = leave_out(results_of(tmp_path / "part.h5", scan={"threshold": [7, 18]}), (1, 1))
    words = ["--theory", "window", "--output", str(tmp_path)]
    assert call("plot", ["flows", str(path), *words]) == 0
    assert "partial run: 3 of 4 tasks" in capsys.readouterr().err
    results = points_of(path)
    mean, error = means(results, "chi")
    assert np.all(np.isfinite(mean))
    assert error[0] > 0.0  # of its two replicas
    assert np.isnan(error[1]) or error[1] > 0.0


@pytest.mark.usefixtures("unwritten")
def test_of_a_partial_run_a_task_that_is_done_is_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = results_of(tmp_path / "part.h5", scan={"threshold": [7, 18]}, run={"duration": 200.0})
    leave_out(path, (0, 0), (0, 1), (1, 0))
    results = points_of(path)
    assert remark(results) == "partial run: 1 of 4 tasks"
    assert task_of(results, None, None) == (1, 1)
    assert task_of(results, 1, None) == (1, 1)
    assert task_of(results, 0, 1) == (0, 1)
    here = [str(path), "--output", str(tmp_path)]
    assert call("plot", ["scene", *here, "--point", "1"]) == 0
    for name in ("comp05", "comp06"):
        assert call("plot", [name, *here, "--theory", "window"]) == 0
        assert "partial run: 1 of 4 tasks" in capsys.readouterr().err
    assert call("film", [*here, "--seconds", "0.2"]) == 0
    assert "partial run: 1 of 4 tasks" in capsys.readouterr().err
    assert call("plot", ["flows", *here, "--point", "0"]) == 2
    assert capsys.readouterr().err.strip().splitlines()[-1].startswith("error: ")


@pytest.fixture(scope="module")
def unlike_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return results of unequal urns and gates, with a disc near urn 2 and one astride the line."""
    discs = [-0.2, 0.05, 0.04, 0.01, 0.0, 0.05]
    return results_of(
        tmp_path_factory.mktemp("unlike") / "unlike.h5", run={"duration": 50.0},
        table={"urn_radius": [1.2, 0.8], "channel2_width": 0.2, "scatterers": discs},
        gate={"threshold": [4, 6]}, scan={"threshold": None, "replicas": 1},
        output={"snapshot_times": [5.0, 5.3], "series_interval": 0.5},
    )  # fmt: skip


@pytest.mark.usefixtures("unwritten")
def test_unlike_sides_are_drawn_as_they_are(unlike_file: Path, tmp_path: Path) -> None:
    film_of = ["film", "--gif", "--seconds", "0.2"]
    for command in (["plot", "flows"], film_of, ["report"], ["plot", "model"]):
        assert call(command[0], [*command[1:], str(unlike_file), "--output", str(tmp_path)]) == 0
    told = (tmp_path / "unlike.html").read_text()
    assert "of equal urns and gates" in told
    assert "renewal gate" not in told
    picture = re.search(r'src="data:image/png;base64,([^"]+)"', told)[1]
    assert plt.imread(io.BytesIO(base64.b64decode(picture)))[..., :3].min() == 0.0
    results = points_of(unlike_file)
    table, shot = results["circuit"].values[0], snapshot_of(results, 0, 0, 0)
    chord, beyond = (np.sqrt(radius**2 - 0.15**2) for radius in (1.2, 0.8))
    ends = [0.5 + chord + np.sqrt(radius**2 - 0.1**2) + 0.5
            for chord, radius in ((chord, 1.2), (beyond, 0.8))]  # fmt: skip
    x, y = np.vstack(scene.walls(table)).T
    assert [x.min(), x.max()] == pytest.approx([-ends[0], ends[1]])
    assert np.hypot(x[x < -0.5] + 0.5 + chord, y[x < -0.5]).min() == pytest.approx(1.2, abs=1e-4)
    assert np.hypot(x[x > 0.5] - 0.5 - beyond, y[x > 0.5]).min() == pytest.approx(0.8, abs=1e-4)
    drawn = picture_of(table, shot)
    discs = sorted(patch.center[0] for patch in drawn.axes[0].patches if isinstance(patch, Circle))
    assert discs == pytest.approx([0.01 - ends[0], ends[1] - 0.2, ends[1] + 0.01])
    titles = [drawn.axes[1].get_title(where) for where in ("left", "right")]
    assert ["$T = 4$" in titles[0], "$T = 6$" in titles[1]] == [True, True]


def test_theory_of_unlike_sides_is_refused_with_a_line(
    unlike_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("plot", ["comp06", str(unlike_file), "--theory", "window"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "threshold is 4 and 6, urn_radius is 1.2 and 0.8, as at point 0" in line


def test_error_of_replicas_covers_their_spread() -> None:
    random = np.random.default_rng(3)
    values = xr.DataArray(random.normal(1.0, 0.1, (500, 8)), dims=("point", "replica"))
    found = mean_error(values, xr.full_like(values, 0.01))
    assert np.mean(np.abs(found["mean"] - 1.0) < 2 * found["error"]) > 0.9
    one = values[:, :1]
    assert (mean_error(one, xr.full_like(one, 0.07))["error"] == 0.07).all()
    assert np.isnan(mean_error(one)["error"]).all()
    with pytest.raises(InputError, match="a variable with the dimension replica"):
        mean_error(one.isel(replica=0))
    assert (mean_error(values[:, :2])["error"] > 0.0).all()


def test_long_intervals_have_no_panel_of_early_times(tmp_path: Path) -> None:
    """None where no entry of the series is."""
    path = results_of(tmp_path / "run.h5", particles={"number": 10}, run={"duration": 20000.0},
                      gate={"threshold": 1}, scan={"threshold": None, "replicas": 1},
                      output={**BARE, "series_interval": 7000.0})  # fmt: skip
    made = circuits.figure_relaxation(points_of(path), theories.named(["window"]))
    assert [axes.get_xlim()[1] for axes in made.axes] == [14000.0] * 2


def test_counted_are_those_in_a_gate_heading_for_the_other() -> None:
    table = Circuit(1000, 7)
    x = np.array([-0.4, -0.4, 0.3, 0.3, -0.1, -0.9, 2.9, -0.2])
    ux = np.array([1.0, -1.0, -1.0, 1.0, 0.5, 1.0, -1.0, np.cos(np.pi / 2)])
    snapshot = Snapshot(0.0, x, np.zeros(8), ux, np.sqrt(1 - ux**2))
    assert scene.counted_by(table, snapshot).tolist() == [1, 0, 2, 0, 1, 0, 0, 0]
    assert scene.next_gate(table, snapshot) == 1


@pytest.mark.parametrize("shape", ["circuit", "urn"])
def test_walls_lie_on_the_table(shape: str) -> None:
    table = Circuit(1000, 7, 0.5, 0.2 if shape == "circuit" else 0.0, 1.2, 0.8, 0.6, shape=shape)
    for wall in scene.walls(table):
        x, y = np.abs(wall.T)
        on_circle = np.isclose(np.hypot(x - table.urn_centre, y), 1.2)
        on_channel = np.isclose(y, 0.25) | np.isclose(y, 0.1) | np.isclose(x, 0.0)
        assert np.all(on_circle | on_channel)


def test_binning_keeps_the_mean() -> None:
    time = np.arange(1.0, 101.0)
    values = np.random.default_rng(1).normal(size=100)
    middle, mean, error = currents.binned(time, values, 10)
    assert mean.mean() == pytest.approx(values.mean())
    assert np.all(np.diff(middle) > 0)
    assert np.all(error > 0)
