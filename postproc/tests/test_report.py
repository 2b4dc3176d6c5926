"""Report and film: self-contained page, hover in a real browser, warnings, frames."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

import f90nml
import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.support.ui import WebDriverWait

import postproc
from postproc.cli import InputError
from postproc.figures import circuits, film
from postproc.figures.circuits import polarised_current_of
from postproc.figures.currents import binned
from postproc.reading.groups import Snapshot, each_series, series_of
from postproc.reading.points import by_point, means, remark
from postproc.reporting import data, report, warn
from postproc.reporting.page import Page
from postproc.tests.commands import call
from postproc.tests.runs import BARE, edited, leave_out, points_of, results_of
from postproc.theory.circuit import Circuit
from postproc.theory.models import MODELS

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import xarray as xr
    from selenium.webdriver.remote.webdriver import WebDriver

FILMED = {"series_interval": 0.2, "snapshot_times": [0.5 * at for at in range(21)]}
BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
PLACE = """
const view = Bokeh.index.find_one_by_id(document_.get_model_by_name("chi").id)
view.el.scrollIntoView({block: "center"})
const [frame, data] = [view.el.getBoundingClientRect(), points.data]
return [["x", "left", "right"], ["y", "bottom", "top"]].map(([axis, low, high]) => Math.round(
  (axis === "x" ? frame.left : frame.top)
  + view.frame[axis + "_scale"].compute((data[low][AT] + data[high][AT]) / 2)))
"""


@pytest.fixture(scope="module")
def run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "run.h5"
    results_of(path, scan={"channel2_width": [0.01, 0.05], "threshold": [4, 8, 18]})
    return leave_out(path, (5, 1))


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("filmed") / "run.h5"
    return results_of(path, run={"duration": 20.0}, output=FILMED)


@pytest.fixture(scope="module")
def page(run_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    assert call("report", [str(run_file), "--output", str(folder)]) == 0
    return folder / "run.html"


def test_page_carries_everything(page: Path) -> None:
    text = page.read_text()
    outside = re.sub(r"<script.*?</script>", "", text, flags=re.S)
    assert re.findall(r'(?:src|href)="(?!data:)', outside) == []
    assert re.findall(r"<script[^>]* src=", text) == []
    assert "1 of 12 tasks have no results" in outside
    assert "N = 1000, w = 0.3, l = 1, l&#39; = 1, chi at the start = 0" in outside
    assert len(text) < 3_000_000
    assert "Namelist of this point" in text


def test_merged_results_have_no_namelist_and_the_numbers_of_replicas_of_all_points(
    tmp_path: Path,
) -> None:
    for count in (1, 2):
        results_of(tmp_path / f"{count}.h5", scan={"threshold": count, "replicas": count},
                   particles={"number": 20}, run={"duration": 5.0}, output=BARE)  # fmt: skip
    text = report([tmp_path / "1.h5", tmp_path / "2.h5"], tmp_path / "page.html").read_text()
    assert "Namelist" not in text.partition("<main>")[2].partition("</main>")[0]
    assert "1 to 2 replicas" in text


def test_columns_say_what_the_file_says(run_file: Path) -> None:
    results = points_of(run_file)
    scan = data.scanned(results)
    assert (scan.across, scan.up, scan.others) == ("threshold", "channel2_width", [])
    columns = data.points_of(results, scan, {"window": MODELS["window"]})
    assert (min(columns["left"]), min(columns["bottom"])) == (2.0, 0.0)  # w' has no negative
    for key, values in scan.keys.items():
        assert values == pytest.approx(results[key].values)
    assert columns["chi"] == pytest.approx(means(results, "chi")[0], rel=1e-4)
    assert columns["tasks"].tolist() == [*["2 of 2"] * 5, "1 of 2"]
    time, series = data.thinned_series(results)
    spread = series["spread"].reshape(6, 2, time.size)
    (own,) = series_of(results, 3, 1)
    assert spread[3, 1, -1] == pytest.approx(abs(float(own["urn1_number"][-1]) / 500.0 - 1.0))
    assert np.isnan(spread[5, 1]).all()
    through = polarised_current_of(own, 1000.0, float(results["urn1_number"][3]))[1].mean()
    assert np.nanmean(series["current"].reshape(6, 2, -1)[3, 1, 1:]) == pytest.approx(
        through, rel=0.1, abs=0.1
    )
    results["point_status"] = "point", [0, 0, 0, 2, 0, 0]
    told = data.points_of(by_point(results), scan, {})["told"]
    assert [told[at].rpartition(": ")[2][:22] == "replicas in two states" for at in (2, 3)] == [
        False, True
    ]  # fmt: skip
    assert scan_of(results, 3) == {"threshold": 8, "channel2_width": 0.05, "replicas": 2}


def test_chi_near_1_has_the_digits_of_its_error(tmp_path: Path) -> None:
    path = results_of(tmp_path / "run.h5", scan={"replicas": 2}, output=BARE)
    with edited(path) as file:
        file["chi"][0] = 0.99996203, 0.99996429
    results = points_of(path)
    told = data.points_of(results, data.scanned(results), {})["told"]
    assert told[0].startswith("chi 0.999963 ± 0.000001")


def test_points_of_a_fine_scan_and_small_currents_stay_apart(tmp_path: Path) -> None:
    """A cell of the table holds ten letters; the axis of a series ends at its largest value."""
    widths = [0.0281231, 0.0281232]
    path = results_of(tmp_path / "run.h5", scan={"channel2_width": widths}, run={"duration": 20.0},
                      output={"series_interval": 5.0})  # fmt: skip
    with edited(path) as file:
        file["polarised_current"][:] = [1.533031464e-7, 1.733031464e-7], [0.003, -0.003 - 1e-19]
        file["series/urn1_number"][:] = 990
        file["series/flow2_12"][:], file["series/flow2_21"][:] = 0.2, 0.0
    points = points_of(path)
    columns = data.points_of(points, data.scanned(points), {})
    assert columns["channel2_width"].tolist() == widths
    assert columns["told"][0].startswith("w' = 0.0281231: ")
    assert columns["current"].tolist() == [1.63303e-7, 0.0]
    parts = Page(points, data.scanned(points), {}, columns)
    (_, _, chi, current, _) = parts.detail()
    assert chi.y_range.end == 1.0
    assert (current.y_range.start, current.y_range.end) == (0.0, pytest.approx(0.2))


def test_series_of_merged_runs_with_other_intervals_keep_their_times(tmp_path: Path) -> None:
    """Between two entries of a series chi is that of the one before, a flow of the interval."""
    for name, interval in (("fine", 3.0), ("coarse", 10.0)):
        results_of(tmp_path / f"{name}.h5", particles={"number": 40, "seed": int(interval)},
                   run={"duration": 30.0}, scan={"replicas": 1},
                   output={**BARE, "series_interval": interval})  # fmt: skip
    files = [tmp_path / "fine.h5", tmp_path / "coarse.h5"]
    points = points_of(*files)
    time, columns = data.thinned_series(points)
    assert time.tolist() == [3.0 * at for at in range(1, 11)]
    drawn = columns["spread"].reshape(2, time.size)
    coarse = next(series for _, series in each_series(points) if series["time"].size == 3)
    at = int(coarse["replica"])
    later = [float(coarse["chi"].sel(time=when - when % 10.0)) for when in time[3:]]
    assert drawn[at].tolist() == pytest.approx([0.0] * 3 + later)
    flows = polarised_current_of(coarse, 40.0, 20.0)[1]
    current = columns["current"].reshape(2, time.size)[at].tolist()
    assert current == pytest.approx([flows[int(when - 1e-9) // 10] for when in time], abs=1e-6)


def scan_of(points: xr.Dataset, at: int) -> dict[str, object]:
    """Return the group &scan of the namelist of a point, filled in as the page does."""
    text, values = data.namelist_of_point(points)
    filled = re.sub(r"'@(\w+)@'", lambda key: str(values[key[1]][at]), text)
    return dict(f90nml.reads(filled)["scan"])


def test_a_point_has_both_values_of_pairs_in_its_namelist_and_its_line(tmp_path: Path) -> None:
    scan = {"threshold": [1, 2], "threshold2": [3, 2], "urn_radius": [1, 2], "urn_radius2": [1, 2]}
    path = results_of(tmp_path / "pairs.h5", scan=scan, particles={"number": 20},
                      run={"duration": 5.0}, output=BARE)  # fmt: skip
    first = {"threshold": 1, "threshold2": 3, "urn_radius": 2.0, "urn_radius2": 2.0}
    points = points_of(path)
    assert scan_of(points, 1) == {**first, "replicas": 2}
    columns = data.points_of(points, data.scanned(points), {})
    assert columns["threshold2"].tolist() == [3, 3, 2, 2]
    assert [line.partition(":")[0] for line in columns["told"][1:3]] == [
        "T = 1, r = 2, T2 = 3", "T = 2, r = 1, T2 = 2"
    ]  # fmt: skip


def test_where_r_of_urn_2_is_named_that_of_urn_1_is(tmp_path: Path) -> None:
    for radii, scan in (
        ([3.0, 1.0], {}),
        (None, {"urn_radius": [3.0, 3.0], "urn_radius2": [1.0, 2.0]}),
    ):
        path = results_of(
            tmp_path / f"{len(scan)}.h5", particles={"number": 20}, gate={"threshold": [9, 2]},
            table={"urn_radius": radii}, run={"duration": 5.0}, output=BARE,
            scan={"threshold": None, "channel1_width": [0.2, 0.3], "replicas": 1, **scan},
        )  # fmt: skip
        points, text = points_of(path), report(path, tmp_path / "page.html").read_text()
        (head,) = re.findall("N = 20,.*? replica[^s]", text)
        for name in ("T = 9", "T2 = 2", "r = 3"):
            assert name in head
        assert head.endswith("1 replica,")
        assert "$r = 3$" in circuits.title(points, 0)
        assert "$T = 9$, $T_2 = 2$" in circuits.title(points, 0)
        assert "$r = 3$" in circuits.common(points)


@pytest.mark.parametrize(
    ("scan", "number"),
    [({"threshold": 7}, 0), ({"threshold": [4, 8]}, 2),
     ({"threshold": [4, 8], "channel1_length": [1.0, 2.0]}, 4),
     ({"threshold": [4, 8], "channel1_length": [1.0, 2.0], "channel2_width": [0.01, 0.02]}, 4)],
)  # fmt: skip
def test_any_scan_has_its_page(tmp_path: Path, scan: dict[str, object], number: int) -> None:
    path = results_of(tmp_path / "run.h5", scan=scan, run={"duration": 20.0})
    assert call("report", [str(path), "--output", str(tmp_path), "--theory", "window"]) == 0
    text = (tmp_path / "run.html").read_text()
    results = points_of(path)
    scanned = data.scanned(results)
    assert len(scanned.others) == max(len(scan) - 2, 0)
    assert len(re.findall(r'"name":"(?:chi|current)(?:_error)?"', text)) == number


def test_a_selector_chooses_all_that_is_drawn(tmp_path: Path) -> None:
    """Lines of transition at values with many digits, too, and the points of curves."""
    scan = {"threshold": [1, 2], "channel2_width": [0.01, 0.3],
            "channel1_length": [1.0, 4.0 / 3.0]}  # fmt: skip
    points = points_of(results_of(tmp_path / "map.h5", scan=scan, run={"duration": 20.0}))
    scanned, models = data.scanned(points), {"window": MODELS["window"]}
    lines = data.map_lines(points, scanned, models)
    columns = data.points_of(points, scanned, models)
    assert scanned.others == ["channel1_length"]
    assert {*lines["channel1_length"]} == {*columns["channel1_length"]} == {1.0, 1.3333333}
    scan = {"threshold": [1, 2], "urn1_fraction": [0.5, 1.0]}
    points = points_of(results_of(tmp_path / "starts.h5", scan=scan, run={"duration": 20.0}))
    scanned = data.scanned(points)
    parts = Page(points, scanned, models, data.points_of(points, scanned, models))
    drawn = [one for panel in parts.panels() for one in panel.renderers]
    assert len(drawn) == 6
    assert all(one.view.filter is parts.cells for one in drawn)


def test_page_escapes_the_namelist(tmp_path: Path) -> None:
    path = results_of(tmp_path / "odd.h5")
    with edited(path) as file:
        text = file.attrs["namelist"] + "! <script>alert(1)</script>\n"
        file.attrs["namelist"] = np.bytes_(text)
    assert call("report", [str(path), "--output", str(tmp_path)]) == 0
    assert "<script>alert" not in (tmp_path / "odd.html").read_text()


@pytest.fixture
def browser(page: Path) -> Iterator[WebDriver]:
    if not (BROWSER and DRIVER):
        pytest.skip("no chromium and chromium-driver here")
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for one in ("--headless=new", "--no-sandbox", "--disable-gpu", "--window-size=1400,1000"):
        options.add_argument(one)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    try:
        driver.get(page.as_uri())
        ready = "return window.Bokeh?.documents[0]?.is_idle ?? false"
        WebDriverWait(driver, 60).until(lambda one: one.execute_script(ready))
        driver.execute_script(
            "window.document_ = Bokeh.documents[0];"
            "window.points = document_.get_model_by_name('points').source"
        )
        yield driver
    finally:
        driver.quit()


@pytest.mark.full
def test_hover_and_click_show_the_point_and_the_console_is_silent(browser: WebDriver) -> None:
    def shown(what: str) -> object:
        return browser.execute_script(f"return {what}")

    def until(what: str) -> None:
        WebDriverWait(browser, 20).until(lambda _: shown(what))

    x, y = browser.execute_script(PLACE.replace("AT", "3"))
    mouse = ActionChains(browser)
    mouse.w3c_actions.pointer_action.move_to_location(x, y)
    mouse.perform()
    until("document_.get_model_by_name('reading').text == points.data.told[3]")
    assert shown("points.inspected.indices") == [3]  # which all maps outline
    mouse = ActionChains(browser)
    mouse.w3c_actions.pointer_action.move_to_location(x, y)
    mouse.w3c_actions.pointer_action.click()
    mouse.perform()
    until("points.selected.indices[0] === 3")
    until("document_.get_model_by_name('name').text.startsWith('Point 3. ')")
    assert shown("document_.get_model_by_name('replicas').view.filter.indices") == [6, 7]
    series = "document_.get_model_by_name('series_spread').renderers[0].data_source.data"
    assert shown(f"{series}.replica") == ["replica 0", "replica 1"]
    scan = f90nml.reads(shown("document_.get_model_by_name('namelist').text"))["scan"]
    assert scan["threshold"] == shown("points.data.threshold[3]")
    assert scan["channel2_width"] == shown("points.data.channel2_width[3]")
    view = "Bokeh.index.find_one_by_id(document_.get_model_by_name('points').id)"
    head = shown(f"{view}.shadow_el.querySelectorAll('.slick-header-column')[3]")
    for _ in range(2):
        head.click()
    order = [shown(f"{view}.grid.getDataItem({row}).chi") for row in range(6)]
    assert order == sorted(order, reverse=True)
    assert browser.get_log("browser") == []
    assert shown("performance.getEntriesByType('resource').length") == 0


@pytest.mark.full
def test_a_page_follows_a_dark_theme_and_its_replicas_fit_a_telephone(browser: WebDriver) -> None:
    """Figures, which are drawn on canvas, as well; when the theme changes and at once."""
    dark = {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
    small = {"width": 400, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    paper = "return document_.get_model_by_name('chi').border_fill_color"
    assert browser.execute_script(paper) == "#ffffff"
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", dark)
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", small)
    WebDriverWait(browser, 20).until(lambda one: one.execute_script(paper) == "#181818")
    background = "return getComputedStyle(document.body).backgroundColor"
    assert browser.execute_script(background) == "rgb(24, 24, 24)"
    beyond = "const one = document.querySelector('.wide'); return one.scrollWidth - one.clientWidth"
    WebDriverWait(browser, 20).until(lambda one: one.execute_script(beyond) <= 0)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 400


def test_report_of_the_single_urn(tmp_path: Path) -> None:
    """It says nothing of a second urn: no polarised current, no start, no transition."""
    scan = {"threshold": [3, 9], "number": [50, 100]}
    path = results_of(tmp_path / "urn.h5", table={"shape": "urn"}, scan=scan,
                      particles={"number": None}, run={"duration": 100.0})  # fmt: skip
    assert call("report", [str(path), "--output", str(tmp_path)]) == 0
    text = (tmp_path / "urn.html").read_text()
    assert text.count("hits on the end wall, per unit time") == 3  # map, errors, series
    for wrong in ("polarised current", "chi at the start", "start chi", "turns stable", "drift",
                  "(N1 - N2)/N", "urn 1 to urn 2"):  # fmt: skip
        assert wrong not in text, wrong


def test_a_run_shorter_than_its_series_interval_has_a_page(tmp_path: Path) -> None:
    output = {"series_interval": 20.0, "snapshot_times": None}
    path = results_of(tmp_path / "run.h5", run={"duration": 5.0}, output=output)
    assert call("report", [str(path), "--output", str(tmp_path), "--theory", "window"]) == 0
    assert "series_spread" not in (tmp_path / "run.html").read_text()
    # Tasks of one file differ in length if their collisions are given.
    length = {"duration": None, "collisions": 60000, "transient_collisions": 0}
    path = results_of(
        tmp_path / "two.h5", run=length, particles={"number": None}, output=output,
        scan={"number": [100, 20000], "replicas": 1},
    )  # fmt: skip
    assert call("report", [str(path), "--output", str(tmp_path), "--theory", "window"]) == 0
    results = points_of(path)
    time, columns = data.thinned_series(results)
    known = np.isfinite(columns["spread"].reshape(2, time.size)).any(axis=1)
    assert known.tolist() == [True, False]


def test_replicas_that_disagree_are_noticed() -> None:
    errors = np.full(4, 0.01)
    assert warn.disagreement(np.array([0.5, 0.51, 0.49, 0.5]), errors) > 0.1
    assert warn.disagreement(np.array([0.5, 0.6, 0.49, 0.5]), errors) < warn.UNLIKELY
    assert warn.disagreement(np.array([0.5, np.nan]), errors[:2]) == 1.0


def test_a_drift_is_noticed() -> None:
    random = np.random.default_rng(2)
    flat = 0.9 + 0.01 * random.normal(size=2000)
    assert not warn.drifts(flat)
    assert warn.drifts(flat - np.linspace(0.0, 0.5, 2000))


@pytest.mark.parametrize(("transient", "moves"), [(0.0, True), (600.0, False)])
def test_chi_moves_where_averages_are_taken(tmp_path: Path, transient: float, moves: bool) -> None:
    """From equal urns it is at 0.93 after 400 time units."""
    length = {"duration": 1200.0, "transient_duration": transient}
    path = results_of(tmp_path / "run.h5", run=length, output={"series_interval": 5.0})
    told = [one for one in warn.warnings(points_of(path)) if "chi still moves while" in one]
    assert bool(told) is moves


def test_rays_along_the_axis_are_noticed() -> None:
    table = Circuit(4, 7, channel2_width=0.01)
    uy = np.array([0.0, 1e-4, 0.1, 1.0])
    rays = Snapshot(0.0, np.zeros(4), np.zeros(4), np.sqrt(1.0 - uy**2), uy)
    assert warn.axial(table, rays) == 2


def test_what_memory_explains_is_no_warning(tmp_path: Path) -> None:
    path = results_of(
        tmp_path / "run.h5", output={"series_interval": 0.0, "snapshot_times": None},
        scan={"channel2_width": [0.01, 0.05], "threshold": 7, "channel1_length": [1.0, 1.000001]},
    )  # fmt: skip
    with edited(path) as file:
        file["chi"][:] = 0.9
        file["chi_error"][:] = 1e-3
        for name in ("current1", "current2", "polarised_current"):
            file[name][:] = [[0.98, 0.98], [0.98, 0.98], [4.9, 4.9], [4.9, 4.9]]
            file[f"{name}_error"][:] = 1e-3
    results = points_of(path)
    assert results["channel2_width"].values.tolist() == [0.01, 0.01, 0.05, 0.05]
    assert warn.warnings(results) == []
    (told,) = warn.explanations(results)
    assert told.startswith("At 4 of 4 points")
    assert "no error" in told
    with edited(path) as file:
        file["polarised_current"][0] = [1.3, 1.3]
    results = points_of(path)
    (wrong,) = warn.warnings(results)
    assert wrong.startswith("T = 7, w' = 0.01, N = 1000, l = 1: the net current is 4")
    assert "More replicas tell" in wrong
    with edited(path) as file:
        file["polarised_current_error"][:] = np.nan
    one_run = by_point(postproc.open_results(path).isel(replica=[0]))
    assert warn.warnings(one_run) == []
    assert not any("no error:" in one for one in warn.explanations(one_run))


def test_memory_of_polygons_is_not_asked_for(tmp_path: Path) -> None:
    """Their polarised states carry more than well mixed urns would, and no theory says how much."""
    file = results_of(
        tmp_path / "hexagons.h5", table={"urn_shape": "polygon", "urn_sides": 6},
        particles={"number": 300, "urn1_fraction": 1.0}, run={"transient_duration": 500.0},
        scan={"threshold": 4}, output=BARE,
    )  # fmt: skip
    assert warn.warnings(points_of(file)) == []


@pytest.mark.parametrize(("width", "measured"), [(0.004, 1.043), (0.02, 1.127), (0.073, 1.189)])
def test_memory_explains_the_conductance_of_the_maps(width: float, measured: float) -> None:
    factor = warn.memory_factor(Circuit(1000, 7, channel2_width=width), 0.9)
    assert abs(factor - measured) < 0.03


def test_circulation_explains_a_quarter_of_a_current() -> None:
    """32 runs of 6000 time units, the fuller urn being the same in all, have 1.231(5) of flow2."""
    circuit = Circuit(1436, 18, 0.442, 0.0616, 1.0, 0.66, 0.51, age=4000.0)
    assert abs(warn.memory_factor(circuit, 0.64) - 1.231) < 0.01
    young = Circuit(1997, 38, 1.159, 0.04704, 1.0, 0.54, 0.83, age=6200.0)  # never 1.77, its last
    assert abs(warn.memory_factor(young, 0.936) - 1.174) < 0.03


def test_of_two_replicas_chance_is_no_excess_of_the_current(tmp_path: Path) -> None:
    """The mean of two is off by more than five standard errors in one of eight cases."""
    path = results_of(tmp_path / "run.h5", scan={"channel2_width": 0.01, "threshold": 7},
                      output={"series_interval": 0.0, "snapshot_times": None})  # fmt: skip
    with edited(path) as file:
        file["chi"][:], file["chi_error"][:] = 0.9, 1e-3
        file["polarised_current"][:] = [1.27, 1.33]
    assert not [one for one in warn.warnings(points_of(path)) if "the net current is" in one]


@pytest.mark.parametrize("kind", ["mp4", "gif"])
def test_film_has_all_its_frames(kind: str, filmed: Path, tmp_path: Path) -> None:
    options = [str(filmed), "--output", str(tmp_path), "--seconds", "0.4"]
    made = tmp_path / f"run_film.{kind}"
    made.write_bytes(b"GIF8 ftyp mine")
    assert call("film", options + (["--gif"] if kind == "gif" else [])) == 2
    made.unlink()
    for _ in range(2):
        assert call("film", options + (["--gif"] if kind == "gif" else [])) == 0
    if kind == "mp4":
        assert imageio_ffmpeg.count_frames_and_secs(str(made))[0] == 10 == 0.4 * film.RATE
    else:
        with Image.open(made) as picture:
            assert picture.n_frames == 5


@pytest.mark.parametrize("kind", ["mp4", "gif"])
def test_a_film_that_cannot_be_written(
    kind: str, filmed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / f"run_film.{kind}").mkdir()
    options = [str(filmed), "--output", str(tmp_path), "--seconds", "0.2"]
    assert call("film", options + (["--gif"] if kind == "gif" else [])) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert f"film.{kind}: " in line
    assert "is a folder" in line


def test_of_what_ffmpeg_says_a_full_disk_is_the_reason(
    filmed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        said = "header: No space left on device\nNothing was written, no packets.\n"
        raise subprocess.CalledProcessError(1, "ffmpeg", stderr=said)

    monkeypatch.setattr(film.FFMpegWriter, "saving", refused)
    with pytest.raises(InputError, match=r"film\.mp4: header: No space left on device"):
        film.film(filmed, tmp_path / "film.mp4")


@pytest.mark.parametrize(("command", "package"), [("report", "bokeh"), ("film", "imageio_ffmpeg")])
def test_without_an_extra_its_command_says_how_to_install_it(
    command: str, package: str, filmed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    for name in [package, *(one for one in sys.modules if one.startswith(f"{package}."))]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, "postproc.reporting.page", raising=False)
    assert call(command, [str(filmed), "--output", str(tmp_path)]) == 2
    install = f"pip install 'battery-postproc[{command}]'"
    assert capsys.readouterr().err == f"error: {package} is missing: {install}\n"


def test_a_frame_shows_its_moment(filmed: Path) -> None:
    results = points_of(filmed)
    scenes = film.read_scenes(results, 0, 0)
    stage = film.Stage(scenes)
    shot = scenes.snapshots[10]
    stage.show(shot, 0.1)
    pixels = np.array(stage.figure.canvas.buffer_rgba())
    assert pixels.shape == (480, 800, 4)
    assert stage.title.get_text().startswith("$t = 5.00$    $T = 7$    $N_1 = ")
    assert stage.now.get_xdata() == [5.0, 5.0]
    assert np.array_equal(stage.dots.get_offsets(), np.column_stack([shot.x, shot.y]))
    _, below, right = stage.figure.axes
    assert below.get_xlim() == (0.0, 10.0)
    assert below.get_ylabel() == r"mass spread $\chi$"
    assert right.get_ylabel() == "net current 2\nurn 2 → 1\n(per unit time)"
    own = scenes.series.sel(time=slice(0.0, 10.0))
    ahead = binned(own["middle"].values, (own["flow2_21"] - own["flow2_12"]).values, 40)[1]
    assert ahead.any()
    for mirrored, sign in (
        (own, 1.0),
        (own.rename(flow2_12="flow2_21", flow2_21="flow2_12"), -1.0),
    ):
        net = film.Stage(film.Scenes(scenes.circuit, scenes.snapshots, mirrored)).figure.axes[-1]
        assert net.lines[1].get_ydata() == pytest.approx(sign * ahead)
        assert net.get_ylim()[0] <= min(sign * ahead) <= max(sign * ahead) <= net.get_ylim()[1]
    stage.show(scenes.snapshots[18], 0.1)
    assert not np.array_equal(pixels, stage.figure.canvas.buffer_rgba())


def test_films_of_two_tasks_have_two_names(filmed: Path, tmp_path: Path) -> None:
    for replica in ("0", "1"):
        words = ["--gif", "--seconds", "0.1", "--replica", replica, "--output", str(tmp_path)]
        assert call("film", [str(filmed), *words]) == 0
    assert sorted(one.name for one in tmp_path.iterdir()) == [
        f"run_film_replica={replica}.gif" for replica in (0, 1)
    ]


def test_a_film_shows_its_snapshots_equally_long() -> None:
    assert film.snapshots_shown(2, 30.0).tolist() == [0] * film.RATE + [1] * film.RATE
    assert film.snapshots_shown(10, 2.0).tolist() == [at for at in range(10) for _ in range(5)]
    many = film.snapshots_shown(3000, 1.0)
    assert [many.size, many[0], many[-1]] == [film.RATE, 0, 2999]
    assert set(np.diff(many)) <= {124, 125}


def test_a_film_is_of_the_kinds_that_are_documented(filmed: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"f\.avi: a film is an \.mp4 or a \.gif"):
        film.film(filmed, tmp_path / "f.avi", seconds=0.2)


def test_film_needs_snapshots(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = results_of(tmp_path / "run.h5", output={"snapshot_times": 0.0})
    assert call("film", [str(path), "--output", str(tmp_path)]) == 2
    assert "at least two snapshots" in capsys.readouterr().err


def test_report_of_nothing_done(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = leave_out(results_of(tmp_path / "none.h5", scan={"replicas": 1}), (0, 0))
    assert call("report", [str(path), "--output", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"error: {path}: no task is complete yet\n"
    assert remark(points_of(path)) == "partial run: 0 of 1 tasks"


@pytest.mark.parametrize(
    ("value", "error", "told"),
    [(0.7278, 0.0049, "0.728 ± 0.005"), (-0.004, 0.011, "0.00 ± 0.01"), (1450.0, 15.0, "1450 ± 15"),
     (0.5, 0.0, "0.5 ± 0"), (0.25, np.nan, "0.25"), (np.nan, 1.0, "-")],
)  # fmt: skip
def test_a_value_has_the_digits_of_its_error(value: float, error: float, told: str) -> None:
    assert data.with_error(value, error) == told
