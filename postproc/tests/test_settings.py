"""Pictures do not depend on a user's matplotlibrc or backend, and leave his settings alone."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

import matplotlib as mpl
import pytest

from postproc.figures import circuits, film, lengths, maps, scene, style, theories
from postproc.reporting import page
from postproc.tests.runs import points_of, results_of

if TYPE_CHECKING:
    from pathlib import Path

HOSTILE = {
    "text.usetex": True, "text.parse_math": False, "text.color": "red", "font.family": "serif",
    "font.size": 17, "font.weight": "bold", "axes.grid": True, "axes.facecolor": "black",
    "axes.labelpad": 12, "axes.spines.right": False, "axes.unicode_minus": False,
    "axes.prop_cycle": mpl.cycler(color=["k"], marker=["x"]), "axes.xmargin": 0.3,
    "figure.constrained_layout.use": False, "figure.constrained_layout.h_pad": 0.3,
    "figure.facecolor": "yellow", "savefig.dpi": 31, "savefig.bbox": "tight",
    "savefig.transparent": True, "image.cmap": "gray", "lines.linestyle": ":",
    "lines.markeredgewidth": 3, "lines.solid_capstyle": "round", "lines.dashed_pattern": (9, 9),
    "legend.loc": "lower left", "legend.fancybox": False, "legend.handlelength": 5,
    "xtick.major.size": 11, "xtick.minor.visible": True, "ytick.labelcolor": "green",
    "scatter.edgecolors": "red", "patch.edgecolor": "red", "patch.force_edgecolor": True,
    "mathtext.default": "rm", "path.sketch": (3, 50, 5), "pdf.compression": 0,
    "animation.codec": "mpeg4",
}  # fmt: skip


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "run.h5"
    scan = {"threshold": [2, 7], "channel2_width": [0.01, 0.05], "replicas": 1}
    return results_of(path, scan=scan, run={"duration": 100.0})


def pictures(file: Path, folder: Path) -> dict[str, bytes]:
    """Return the contents of pictures of each kind."""
    window = theories.named(["window"])
    points = points_of(file)
    made = {
        "map": maps.figure_phase_diagram(points, window),
        "flows": circuits.figure_flows(points.isel(point=[0]), window),
        "scene": scene.figure_scene(points),
    }
    film.write(film.read_scenes(points, 0, 0), 0.2, folder / "film.gif")
    style.note(made["scene"].axes[0], "partial run")
    found = {}
    for name, one in made.items():
        for path in style.save(one, folder, name):
            found[path.name] = path.read_bytes()
    found["film"] = (folder / "film.gif").read_bytes()
    found["page"] = page._picture(points["circuit"].values[0]).encode()
    return found


def test_pictures_and_the_users_settings_leave_each_other_alone(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(style, "RESOLUTION", 50)
    monkeypatch.setitem(style.SETTINGS, "pdf.fonttype", 3)  # letters as outlines, which is faster
    expected = pictures(file, tmp_path)
    with mpl.rc_context(HOSTILE):
        before = dict(mpl.rcParams)
        assert pictures(file, tmp_path) == expected
        assert dict(mpl.rcParams) == before


def test_a_command_draws_alike_whatever_backend_and_matplotlibrc_say(tmp_path: Path) -> None:
    lines = [f"{name}: {value}" for name, value in HOSTILE.items() if "cycle" not in name]
    (tmp_path / "matplotlibrc").write_text("\n".join(lines).replace("(", "").replace(")", ""))
    environment = {**os.environ, "MATPLOTLIBRC": str(tmp_path)}
    environment["MPLBACKEND"] = "module://matplotlib_of_a_notebook.backend"
    command = [sys.executable, "-m", "postproc", "plot", "model", "--output", str(tmp_path)]
    ended = subprocess.run(command, env=environment, text=True, capture_output=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
    for path in style.save(lengths.figure_circuit(), tmp_path / "here", "model"):
        assert (tmp_path / path.name).read_bytes() == path.read_bytes(), path.name


def test_settings_with_which_matplotlib_cannot_be_imported_are_one_line(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "postproc", "plot", "model", "--output", str(tmp_path)]
    for text, words in (
        (b"# K\xf6rper", "can't decode byte 0xf6"),
        (b"axes.formatter.use_locale: True", "unsupported locale"),
    ):
        (tmp_path / "matplotlibrc").write_bytes(text + b"\n")
        environment = {**os.environ, "MATPLOTLIBRC": str(tmp_path), "LC_ALL": "xx_XX.UTF-8"}
        ended = subprocess.run(command, env=environment, capture_output=True, check=False)
        assert ended.returncode == 2
        last = ended.stderr.decode().splitlines()[-1]
        assert last.startswith("error: matplotlib cannot be imported with the settings of this")
        assert words in last
        assert b"Traceback" not in ended.stderr


def test_a_name_that_is_too_long_for_a_file_ends_with_its_digest(tmp_path: Path) -> None:
    made = {path for end in "ab" for path in style.save(style.figure(), tmp_path, 300 * "x" + end)}
    assert len(made) == 4
    assert all(path.is_file() for path in made)
