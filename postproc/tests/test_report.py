"""Report and film: self-contained page, hover in a real browser, warnings, frames."""

from __future__ import annotations

import re
import shutil
import subprocess
from typing import TYPE_CHECKING

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from postproc.figures import film
from postproc.reading.results import Results, Snapshot
from postproc.report import warn
from postproc.tests.commands import call
from postproc.tests.runs import edited, leave_out, results_of
from postproc.theory.circuit import Circuit

if TYPE_CHECKING:
    from pathlib import Path

FILMED = {"series_interval": 0.2, "snapshot_times": [0.5 * at for at in range(21)]}
BROWSER = shutil.which("chromium")
BROWSER_OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-logging=stderr",
)
HOVER = """<script>
const cell = document.querySelectorAll("rect[data-text]")[1];
cell.dispatchEvent(new MouseEvent("mouseenter"));
</script>"""


@pytest.fixture(scope="module")
def run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "run.h5"
    results_of(path, scan={"channel2_width": [0.01, 0.05], "threshold": [4, 8, 18]})
    return leave_out(path, (5, 1))


@pytest.fixture(scope="module")
def page(run_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    assert call("report", [str(run_file), "--output", str(folder)]) == 0
    return folder / "run.html"


def test_page_carries_everything(page: Path) -> None:
    text = page.read_text()
    assert "@TITLE@" not in text
    assert "@BODY@" not in text
    assert re.findall(r'(?:src|href)="(?!data:)', text) == []
    assert "http" not in re.sub(r"base64,[A-Za-z0-9+/=]+", "", text)
    assert text.count("<img ") >= 2
    assert text.count("data-text=") == 12
    assert "1 of 12 tasks have no results" in text


def test_page_escapes_the_namelist(tmp_path: Path) -> None:
    path = results_of(tmp_path / "odd.h5")
    with edited(path) as file:
        text = file.attrs["namelist"] + "! <script>alert(1)</script>\n"
        file.attrs["namelist"] = np.bytes_(text)
    assert call("report", [str(path), "--output", str(tmp_path)]) == 0
    assert "<script>alert" not in (tmp_path / "odd.html").read_text()


@pytest.mark.full
@pytest.mark.skipif(BROWSER is None, reason="no chromium here")
def test_hover_shows_the_value_and_the_console_is_silent(page: Path, tmp_path: Path) -> None:
    hovered = tmp_path / "hovered.html"
    hovered.write_text(page.read_text().replace("</body>", HOVER + "</body>"))
    done = subprocess.run(
        [
            BROWSER,
            *BROWSER_OPTIONS,
            f"--user-data-dir={tmp_path / 'profile'}",
            "--dump-dom",
            hovered.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    reading = re.search(r'id="reading">([^<]*)<', done.stdout)
    assert reading is not None
    assert reading[1].startswith("T = ")
    assert "chi" in reading[1]
    assert "CONSOLE" not in done.stderr


def test_report_of_the_single_urn(tmp_path: Path) -> None:
    path = results_of(tmp_path / "urn.h5", table={"shape": "urn"}, scan={"threshold": [3, 9]})
    assert call("report", [str(path), "--output", str(tmp_path)]) == 0


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


def test_rays_along_the_axis_are_noticed() -> None:
    table = Circuit(4, 7, channel2_width=0.01)
    uy = np.array([0.0, 1e-4, 0.1, 1.0])
    rays = Snapshot(0.0, np.zeros(4), np.zeros(4), np.sqrt(1.0 - uy**2), uy)
    assert warn.axial(table, rays) == 2


def test_what_memory_explains_is_no_warning(tmp_path: Path) -> None:
    path = results_of(
        tmp_path / "run.h5", scan={"channel2_width": [0.01, 0.05], "threshold": [7, 10]},
        output={"series_interval": 0.0, "snapshot_times": None},
    )  # fmt: skip
    with edited(path) as file:
        file["chi"][:] = 0.9
        file["chi_error"][:] = 1e-3
        for name in ("current1", "current2", "polarised_current"):
            file[name][:] = [[0.98, 0.98], [4.9, 4.9], [0.98, 0.98], [4.9, 4.9]]
            file[f"{name}_error"][:] = 1e-3
    with Results(path) as results:
        assert results.value("channel2_width").tolist() == [0.01, 0.05, 0.01, 0.05]
        assert warn.warnings(results) == []
        (told,) = warn.explanations(results)
    assert told.startswith("At 4 of 4 points")
    assert "no error" in told
    with edited(path) as file:
        file["polarised_current"][0] = [1.3, 1.3]
    with Results(path) as results:
        (wrong,) = warn.warnings(results)
    assert wrong.startswith("T = 7, w' = 0.01, N = 1000: the net current is 4")
    assert "More replicas tell" in wrong


@pytest.mark.parametrize(("width", "measured"), [(0.004, 1.043), (0.02, 1.127), (0.073, 1.189)])
def test_memory_explains_the_conductance_of_the_maps(width: float, measured: float) -> None:
    assert warn.memory_factor(Circuit(1000, 7, channel2_width=width)) > measured
    assert warn.memory_factor(Circuit(1000, 7, channel2_width=width)) < measured + 0.2


def test_flight_stays_on_the_table() -> None:
    table = Circuit(3000, 7)
    random = np.random.default_rng(7)
    angle = random.uniform(0.0, 2.0 * np.pi, 3000)
    x = random.uniform(-0.5, 0.5, 3000)
    y = random.uniform(-0.15, 0.15, 3000)
    moved = film.flown(table, Snapshot(0.0, x, y, np.cos(angle), np.sin(angle)), 0.5)
    still = np.abs(moved[0]) <= 0.5
    assert np.abs(moved[1][still]).max() <= 0.15 + 1e-12
    line = Snapshot(
        0.0, np.full(2, table.end - 0.1), np.zeros(2), np.array([1.0, -1.0]), np.zeros(2)
    )
    assert film.flown(table, line, 0.3)[0] == pytest.approx([0.2 - table.end, table.end - 0.4])
    at_rest = film.flown(table, Snapshot(0.0, x, y, np.cos(angle), np.sin(angle)), 0.0)
    assert at_rest[1] == pytest.approx(y)


@pytest.mark.parametrize("kind", ["mp4", "gif"])
def test_film_has_all_its_frames(kind: str, tmp_path: Path) -> None:
    path = results_of(tmp_path / "run.h5", run={"duration": 20.0}, output=FILMED)
    options = [str(path), "--output", str(tmp_path), "--seconds", "1"]
    assert call("film", options + (["--gif"] if kind == "gif" else [])) == 0
    made = tmp_path / f"film.{kind}"
    if kind == "mp4":
        assert imageio_ffmpeg.count_frames_and_secs(str(made))[0] == film.RATE
    else:
        with Image.open(made) as picture:
            assert picture.n_frames == (film.RATE + 1) // 2


def test_a_frame_shows_its_moment(tmp_path: Path) -> None:
    path = results_of(tmp_path / "run.h5", run={"duration": 20.0}, output=FILMED)
    with Results(path) as results:
        scenes = film.read_scenes(results, 0, 0)
    stage = film.Stage(scenes)
    pixels = stage.show(5.25, 0.1)
    assert pixels.shape == (480, 800, 3)
    assert stage.title.get_text().startswith("$t = 5.25$    $T = 7$    $N_1 = ")
    assert stage.now.get_xdata() == [5.25, 5.25]
    x, y = film.flown(scenes.circuit, scenes.snapshots[10], 0.25)
    assert np.array(stage.dots.get_offsets()) == pytest.approx(np.column_stack([x, y]))
    _, below, right = stage.figure.axes
    assert below.get_xlim() == (0.0, 10.0)
    assert below.get_ylabel() == r"mass spread $\chi$"
    assert right.get_ylabel() == "net current 2\n(per unit time)"
    assert not np.array_equal(pixels, stage.show(9.0, 0.1))


def test_no_frame_shows_a_time_without_its_particles() -> None:
    far = np.array([0.0, 2000.0])
    assert np.unique(film.frame_times(far, 30.0)) == pytest.approx(far)
    many = np.arange(3000.0)
    shown = film.frame_times(many, 1.0)
    assert shown.size == film.RATE
    assert np.isin(shown, many).all()
    close = film.frame_times(np.arange(0.0, 10.0, 0.5), 2.0)
    assert close.size == 2 * film.RATE
    assert np.diff(close) == pytest.approx(9.5 / (2 * film.RATE - 1))


def test_film_needs_snapshots(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = results_of(tmp_path / "run.h5", output={"snapshot_times": 0.0})
    assert call("film", [str(path), "--output", str(tmp_path)]) == 2
    assert "at least two snapshots" in capsys.readouterr().err


def test_report_of_nothing_done(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = leave_out(results_of(tmp_path / "none.h5", scan={"replicas": 1}), (0, 0))
    assert call("report", [str(path), "--output", str(tmp_path)]) == 2
    assert "no task is complete" in capsys.readouterr().err
    with Results(path) as results:
        assert results.remark == "partial run: 0 of 1 tasks"
