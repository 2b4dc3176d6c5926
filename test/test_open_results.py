"""Results on the grid of their scan: every cell is the point of the file that it says it is."""

from __future__ import annotations

import re
import warnings
from itertools import product
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import pandas as pd
import pytest
from support.program import namelist, run

import postproc
from postproc.cli import InputError
from postproc.reading.grid import selected
from postproc.reading.points import PARAMETERS
from postproc.tests.runs import edited, leave_out, points_of
from postproc.theory.circuit import Circuit, single_urn_current
from postproc.theory.models import MODELS, describe

if TYPE_CHECKING:
    from pathlib import Path

FRACTIONS = {"threshold_fraction": "0.1, 0.05, 0.2", "number": "60, 35", "urn1_fraction": "1, 0.3"}
SHARES = {"threshold_fraction": "threshold", "urn1_fraction": "urn1_number"}
SCANS = {
    "widths": {"threshold": "7, 3", "channel1_width": "0.3, 0.2", "channel2_width": "0.1, 0.02"},
    "lengths": {"channel1_length": "2, 1, 0.5", "channel2_length_range": "1, 3, 2"},
    "radii": {"urn_radius": "1.5, 1.0"},
    "pairs": {"threshold": "3, 7, 5", "threshold2": "4, 8, 6", "channel2_width": "0.1, 0.02"},
    "pairs_of_radii": {"threshold": "3, 7", "urn_radius": "1.5, 1.0", "urn_radius2": "1.2, 1.4"},
    "second_alone": {"threshold2": "4, 8", "urn_radius2": "1.2, 1.4, 1.1"},
    "fractions": FRACTIONS,
    "single": {},
    "list_of_one": {"threshold": "4"},
}


def results_of(folder: Path, scan: dict[str, Any], **groups: dict[str, Any]) -> Path:
    """Run a short scan in a folder, two replicas a point."""
    given = {
        "particles": {} if "number" in scan else {"number": 40},
        "gate": {} if {"threshold", "threshold_fraction"} & set(scan) else {"threshold": 5},
        "run": {"collisions": 400, "transient_collisions": 0},
        **groups,
    }
    text = namelist(**given, scan={**scan, "replicas": 2})
    (folder / "in.nml").write_text(text, encoding="utf-8")
    done = run("--quiet", "in.nml", folder=folder)
    assert done.returncode == 0, done.stderr
    return folder / "battery.h5"


@pytest.mark.parametrize("scan", SCANS.values(), ids=SCANS)
def test_a_cell_of_the_grid_is_the_point_that_it_says(tmp_path: Path, scan: dict[str, str]) -> None:
    path = results_of(tmp_path, scan, output={"series_interval": 0.5})
    data = postproc.open_results(path)
    series = postproc.open_results(path, group="series")
    # The second list of a pair goes with the first.
    keys = [key.removesuffix("_range") for key in scan
            if not (key.endswith("2") and key[:-1] in scan)]  # fmt: skip
    assert data["chi"].dims == (*keys, "replica")
    assert series["urn1_number"].dims == (*keys, "replica", "time")
    with h5py.File(path) as file:
        for point, cell in enumerate(np.ndindex(*(data.sizes[key] for key in keys))):
            there = data.isel(dict(zip(keys, cell, strict=True)))
            for name in ("chi", "seed", *(one for one in PARAMETERS if one in file)):
                expected = np.ravel(file[name][point])[: None if name in ("chi", "seed") else 1]
                assert np.array_equal(there[name].values.ravel(), expected, equal_nan=True), name
            for name, both in (("threshold", "gate_threshold"), ("urn_radius", "urn_radius")):
                second = there.get(f"{name}2", there[name])
                assert [there[name], second] == file[both][point].tolist()
            for share, whole in SHARES.items():
                if share in keys:
                    assert there[whole] == int(float(there[share] * there["number"]) + 0.5)
            n1 = series["urn1_number"].isel(dict(zip(keys, cell, strict=True)))
            assert np.array_equal(n1.fillna(-1), file["series/urn1_number"][point])


def test_units_meanings_and_namelist_come_along(tmp_path: Path) -> None:
    path = results_of(tmp_path, SCANS["widths"])
    data = postproc.open_results(path)
    for name, one in data.variables.items():
        assert one.attrs["long_name"], name
        assert one.attrs.get("units") != "1"
    assert data["chi"].attrs["long_name"] == "mass spread"
    assert data["chi_error"].attrs["long_name"] == "mass spread, standard error"
    assert data["flow1_12"].attrs["long_name"] == "flow of channel 1, urn 1 to 2"
    assert "middle line" in data["flow1_12"].attrs["comment"]
    assert data["channel1_width"].attrs["units"] == "length"
    assert len(data.to_dataframe()) == data["task"].size
    assert data.attrs["namelist"] == (tmp_path / "in.nml").read_text(encoding="utf-8").rstrip()
    assert data.attrs["status"] == "complete"
    assert data.attrs["tasks"] == "16 of 16 tasks are complete"
    assert data["threshold"].dtype.kind == "i"
    assert data["channel1_length"].dims == ()
    mean = data.chi.sel(threshold=7).mean("replica")
    assert mean.dims == ("channel1_width", "channel2_width")
    assert mean.plot().axes.get_title() == "threshold = 7"
    data.to_netcdf(tmp_path / "copy.nc", engine="h5netcdf")


def test_what_a_scan_does_not_change_has_no_dimension(tmp_path: Path) -> None:
    data = postproc.open_results(results_of(tmp_path, FRACTIONS))
    assert data["threshold"].dims == ("threshold_fraction", "number")
    assert data["urn1_number"].dims == ("number", "urn1_fraction")
    assert data["channel2_width"].dims == ()


def test_missing_tasks_are_not_numbers_and_it_is_said(tmp_path: Path) -> None:
    path = results_of(tmp_path, {"threshold": "3, 7"}, output={"final_state": ".true."})
    whole = postproc.open_results(path)
    with edited(path) as file:
        file["task_status"][1, 0] = 1  # failed, with numbers that do not count
    leave_out(path, (0, 1))
    data = postproc.open_results(path)
    assert data.attrs["tasks"] == "2 of 4 tasks are complete"
    assert data.attrs["status"] == "partial"
    for name in ("chi", "current1", "collisions", "time"):
        known = np.isfinite(data[name])
        assert known.values.tolist() == [[True, False], [False, True]], name
        assert (data[name].values[known] == whole[name].values[known]).all()
    final = postproc.open_results(path, group="final")
    assert np.isfinite(final["x"]).all("particle").values.tolist()[1] == [False, True]


def test_a_table_has_a_row_for_each_point_with_the_means_of_the_dataset(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the order of the grid; the error is the scatter of two replicas, or one's own."""
    path = results_of(tmp_path, {"threshold": "7, 3", "channel2_width": "0.1, 0.02"})
    with edited(path) as file:
        file["task_status"][2, 0] = 1
        file["chi_error"][2, 1] = 0.25
    data, table = postproc.open_results(path), postproc.table(path, theory="window")
    assert capsys.readouterr().err == f"{path}: partial run: 7 of 8 tasks\n"
    assert table["threshold"].tolist() == [7, 7, 3, 3]
    assert table["replicas"].tolist() == [2, 2, 1, 2]
    chi = data["chi"].values.reshape(4, 2)
    assert table["chi"].tolist() == pytest.approx([*np.nanmean(chi, axis=1)])
    scatter = np.abs(chi[:, 0] - chi[:, 1]) / 2.0
    scatter[2] = 0.25
    assert table["chi_error"].tolist() == pytest.approx([*scatter])
    known = postproc.Circuit(number=40, threshold=3, channel2_width=0.1).states()[-1]
    assert table["window_chi"][2] == pytest.approx(known.mass_spread)


def test_theory_is_that_of_each_point(tmp_path: Path) -> None:
    path = results_of(
        tmp_path, {"number": "500, 1000", "threshold": "7, 30", "channel2_width": "0.01, 0.3"}
    )
    data = postproc.open_results(path, theory=["window", "renewal"])
    assert data["theory"].values.tolist() == ["window", "renewal"]
    one = postproc.open_results(path, theory="renewal")
    assert one["theory_chi"].dims == ("threshold", "number", "channel2_width")
    for threshold, number, width in product((7, 30), (500, 1000), (0.01, 0.3)):
        point = {"threshold": threshold, "number": number, "channel2_width": width}
        told = describe(Circuit(number, threshold, channel2_width=width), MODELS["renewal"])
        stable = [root for root in told["roots"] if root["kind"] == "stable"]
        there = one.sel(point)
        # From the homogeneous start the drift leads away only where that state is unstable.
        away = told["homogeneous"] == "unstable"
        assert float(there["theory_chi"]) == (stable[0]["mass_spread"] if away else 0.0)
        assert float(there["theory_polarised_current"]) == (
            stable[0]["net_current"] if away else 0.0
        )
        assert bool(there["theory_homogeneous_stable"]) == (told["homogeneous"] == "stable")
        both = data.sel(point)["theory_chi"]
        assert float(both.sel(theory="renewal")) == float(there["theory_chi"])
    assert 0.9 < float(one["theory_chi"].sel(threshold=7, number=1000, channel2_width=0.01)) < 1
    assert bool((data["theory_chi"].sel(theory="window") != one["theory_chi"]).any())


def test_theories_of_a_dataset_are_replaced_by_others(tmp_path: Path) -> None:
    path = results_of(tmp_path, {"threshold": "3, 7"})
    two = postproc.open_results(path, theory=["window", "renewal"])
    with_window = postproc.table(path, theory="window")
    pd.testing.assert_frame_equal(postproc.table(two, theory="window"), with_window)


def test_a_single_urn_has_its_own_theory(tmp_path: Path) -> None:
    path = results_of(tmp_path, {"number": "40, 80"}, table={"shape": "'urn'"})
    data = postproc.open_results(path, theory="window")
    expected = [float(single_urn_current(Circuit(n, 5, channel2_width=0.0, shape="urn")))
                for n in (40, 80)]  # fmt: skip
    assert data["theory_current1"].values.tolist() == expected
    assert postproc.table(path, theory="window")["window_current1"].tolist() == expected
    assert "theory_chi" not in data
    assert np.isnan(data["chi"]).all()


def test_a_file_without_its_grid_comes_by_points(tmp_path: Path) -> None:
    path = results_of(tmp_path, SCANS["widths"])
    with edited(path) as file:
        del file.attrs["scan"]
        del file["scan"]
    data = postproc.open_results(path)
    assert data["chi"].dims == ("point", "replica")
    assert data["threshold"].dims == ("point",)


def test_files_of_the_version_before_are_read(tmp_path: Path) -> None:
    path = results_of(tmp_path, {"threshold": "3, 7"})
    before = postproc.open_results(path)
    with edited(path) as file:
        file.attrs["version"] = np.bytes_("0.1.0")
    after = postproc.open_results(path)
    assert after.attrs["version"] == "0.1.0"
    assert after.equals(before)


def test_a_file_that_was_opened_for_writing_is_read_with_one_warning(tmp_path: Path) -> None:
    """So is one to which something was added, and one that is open, also in this Python."""
    path = results_of(tmp_path, {"threshold": "3, 7"}, output={"final_state": ".true."})
    before = postproc.open_results(path)
    for locking in (False, True):
        with h5py.File(path, "r", locking=locking):
            assert postproc.open_results(path).identical(before)
    with h5py.File(path, "a") as file:
        assert postproc.open_results(path).identical(before)
        file.attrs["remark"] = "of its reader"
    with pytest.warns(UserWarning, match="has no digest at its end") as warned:
        after = postproc.open_results(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert after.final.equals(before.final)
    assert len(warned) == 1
    assert after.attrs.pop("remark") == "of its reader"
    assert after.identical(before)


def other_version(path: Path) -> None:
    with edited(path) as file:
        file.attrs["version"] = np.bytes_("3.0.0")


def another_grid(path: Path) -> None:
    with edited(path) as file:
        file.attrs["scan"] = np.bytes_("")


def lengthened(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[:5000] + content[4000:])


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:3000])


def not_hdf5(path: Path) -> None:
    path.write_text("&particles\n/\n", encoding="utf-8")


BAD = {
    other_version: r"of version 3.0.0 of battery; 0.1.x to 0.4.x can be read",
    another_grid: "damaged: its points do not fill the grid",
    lengthened: "damaged: its digest is wrong",
    cut: "only a piece of its file|no digest at its end",
    not_hdf5: "not an HDF5 file",
    lambda path: path.unlink(): "no such file",
}


@pytest.mark.parametrize(("harm", "message"), BAD.items())
def test_a_bad_file_is_one_line_that_names_it(tmp_path: Path, harm: Any, message: str) -> None:
    path = results_of(tmp_path, {"threshold": "3, 7"})
    harm(path)
    with pytest.raises(ValueError, match=message) as caught:
        postproc.open_results(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_scan_over_pairs_of_radii_has_both(tmp_path: Path) -> None:
    path = results_of(tmp_path, {"urn_radius": "1.5, 1.0", "urn_radius2": "1.0, 2.0"})
    for data in (postproc.open_results(path), postproc.open_results(path, theory="window")):
        assert data["urn_radius"].values.tolist() == [1.5, 1.0]
        assert data["urn_radius2"].dims == ("urn_radius",)
        assert data["urn_radius2"].values.tolist() == [1.0, 2.0]
        assert data["urn_radius2"].attrs["units"] == "length"


def test_a_theory_or_group_that_is_not_there_is_named(tmp_path: Path) -> None:
    path = results_of(tmp_path, {"urn_radius": "1.5, 1.0"})
    with pytest.raises(InputError, match=r"no theory 'widow'; there are window, renewal, "):
        postproc.open_results(path, theory="widow")
    with pytest.raises(InputError, match="has no series"):
        postproc.open_results(path, group="series")
    for group in ("chi", "", "/", "scan", 3):
        with pytest.raises(InputError, match=r"there is no group .*; there are series, snapshots"):
            postproc.open_results(path, group=group)
    unequal = results_of(tmp_path, {"channel2_width": "0.1"}, gate={"threshold": "5, 6"},
                         output={"file": "'unequal.h5'"}).with_name("unequal.h5")  # fmt: skip
    data = postproc.open_results(unequal)
    assert [int(data[name]) for name in ("threshold", "threshold2")] == [5, 6]


def test_the_current_of_a_theory_is_that_of_the_age_of_the_runs(tmp_path: Path) -> None:
    path = results_of(tmp_path, {"threshold": "7"}, particles={"number": 1000},
                      run={"duration": 300.0, "transient_duration": 100.0})  # fmt: skip
    data = postproc.open_results(path, theory="direction")
    root = describe(Circuit(1000, 7, age=200.0), MODELS["direction"])["roots"][-1]
    assert data["theory_polarised_current"].item() == root["net_current"]
    assert root["net_current"] < 0.99 * root["net_current_infinite_age"]


def test_the_age_of_a_run_that_goes_on_counts_from_the_start_of_the_first(tmp_path: Path) -> None:
    """Also merged; a clock that is set forward makes no run older."""
    case = {"particles": {"number": 40}, "gate": {"threshold": 7},
            "run": {"duration": 300.0, "transient_duration": 100.0, "start_time": 5000.0},
            "output": {"file": "new.h5", "final_state": True}}  # fmt: skip
    new = postproc.run(case, folder=tmp_path, quiet=True)
    state = postproc.open_results(new).final.isel(replica=0)
    np.savetxt(tmp_path / "next.txt", state[["x", "y", "ux", "uy"]].to_array().T)
    case["particles"]["initial_file"] = "next.txt"
    on = postproc.run({**case, "output": {"file": "on.h5"}}, folder=tmp_path, quiet=True)
    for files, ages in (([new], [200.0]), ([on], [5200.0]), ([new, on], [200.0, 5200.0])):
        assert [one.age for one in points_of(*files)["circuit"].values] == ages


def test_a_theory_of_unlike_gates_has_both(tmp_path: Path) -> None:
    path = results_of(tmp_path, {"channel2_width": "0.01"}, gate={"threshold": "7, 30"},
                      table={"urn_radius": "1, 1.2"}, particles={"number": 1000})  # fmt: skip
    data = postproc.open_results(path, theory="direction")
    assert data["theory_polarised_current"] > 0.0  # urn 1 is the fuller one
    assert np.all(data["polarised_current"] > 0.0)
    unlike = Circuit(1000, 7, gate2_threshold=30, urn2_radius=1.2)
    told = describe(unlike, MODELS["direction"])
    best = max(root["mass_spread"] for root in told["roots"] if root["kind"] == "stable")
    assert data["theory_chi"].item() == best
    assert np.isnan(data["theory_transition_width"])
    assert "theory_chi_error" not in data


def test_merged_files_of_other_lengths_have_their_events_and_one_axis(tmp_path: Path) -> None:
    """A figure goes as far as the shortest run, and pairs what was at the same time."""
    files = []
    for seed, duration in ((1, 20.0), (2, 60.0)):
        groups = {"particles": {"number": 20, "seed": seed}, "gate": {"threshold": 2},
                  "run": {"duration": duration},
                  "output": {"file": f"{seed}.h5", "event_log": True,
                             "series_interval": 0.5 * seed}}  # fmt: skip
        files.append(postproc.run(groups, folder=tmp_path, quiet=True))
    both, alone = postproc.merge(files), [postproc.open_results(one) for one in files]
    lengths = [one.events.sizes["event"] for one in alone]
    assert both.events["time"].notnull().sum("event").values.tolist() == lengths
    (line,) = postproc.plot.relaxation(both)
    assert line.get_xdata()[[0, -1]].tolist() == [0.0, 20.0]


@pytest.mark.parametrize("scan", [
    {"threshold": "3, 7", "threshold2": "4, 8", "urn_radius": "1, 1.2", "urn_radius2": "1, 1.4"},
    {"number": "10, 20, 40", "threshold_fraction": "0.1, 0.2", "urn1_fraction": "0.5, 0.7"},
], ids=["pairs", "fractions"])  # fmt: skip
def test_what_a_figure_advises_to_select_can_be_selected(
    tmp_path: Path, scan: dict[str, str]
) -> None:
    data = postproc.open_results(results_of(tmp_path, scan))
    with pytest.raises(InputError, match="no place for") as refused:
        postproc.plot.curves(data)
    ((key, value),) = re.findall(r"--select (\w+)=(\S+)", str(refused.value))
    assert key in selected(data, [(key, float(value))]).coords


def test_lifetimes_combine_runs_of_one_circuit_and_refuse_other_widths(tmp_path: Path) -> None:
    """Starts with N1 = 0 and N1 = N are of one kind; a figure has no place for two widths w."""
    scans = {"starts": {"urn1_fraction": [0.0, 1.0], "replicas": 2},
             "widths": {"channel1_width": [0.2, 0.4]}}  # fmt: skip
    found = {}
    for name, scan in scans.items():
        groups = {"particles": {"number": 40}, "gate": {"threshold": 1}, "run": {"duration": 100.0},
                  "output": {"file": f"{name}.h5", "series_interval": 1.0},
                  "scan": scan}  # fmt: skip
        found[name] = postproc.open_results(postproc.run(groups, folder=tmp_path, quiet=True))
    assert len(postproc.plot.lifetimes(found["starts"])) == 1
    with pytest.raises(InputError, match="no place for channel1_width"):
        postproc.plot.lifetimes(found["widths"])
