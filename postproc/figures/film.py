"""Film of a circuit from the snapshots of a run."""

from __future__ import annotations

import errno
import logging
import math
import os
import subprocess
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.patches import Rectangle

from postproc import cli
from postproc.figures import style
from postproc.figures.currents import binned
from postproc.figures.scene import counted_by, draw_table
from postproc.progress import each
from postproc.reading.grid import dataset_of
from postproc.reading.groups import group_of, series_of, snapshots_of
from postproc.reading.points import by_point, files_of, remark, say, task_of

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from postproc.reading.groups import Snapshot
    from postproc.theory.circuit import Circuit

    Floats = NDArray[np.float64]

SECONDS = 30.0  # longest film
RATE = 25  # frames a second
DOTS = 100  # dots per inch
ENCODED = ["-preset", "veryfast", "-crf", "23", "-pix_fmt", "yuv420p", "-movflags", "+faststart"]
FLASH = 6  # frames that a flash lasts
LONGEST_FLASH = 0.5  # longest flash in simulated time

# it repeats what ffmpeg says of an error, which is in ours
logging.getLogger("matplotlib.animation").setLevel(logging.ERROR)


@dataclass
class Scenes:
    """Data of a film.

    Attributes
    ----------
    circuit : of the task.
    snapshots : in order of time.
    series : of the same task, or None.
    reversals : times and gates of the reversals, shape (reversal,) each.
    """

    circuit: Circuit
    snapshots: list[Snapshot]
    series: xr.Dataset | None = None
    reversals: tuple[Floats, Floats] = field(default_factory=lambda: (np.empty(0), np.empty(0)))

    @property
    def times(self) -> Floats:
        """Times of the snapshots."""
        return np.array([snapshot.time for snapshot in self.snapshots])


def read_scenes(points: xr.Dataset, point: int, replica: int) -> Scenes:
    """Read the data for a film of one task."""
    snapshots = snapshots_of(points, point, replica)
    if len(snapshots) < 2:
        raise cli.InputError(f"{files_of(points)}: a film needs at least two snapshots")
    scenes = Scenes(points["circuit"].values[point], snapshots)
    with suppress(cli.InputError):  # none
        (scenes.series,) = series_of(points, point, replica)
    with suppress(cli.InputError):
        log = group_of(points.isel(point=point, replica=replica), "events")
        turned = log.isel(event=np.flatnonzero(log["kind"] == 2))
        scenes.reversals = turned["time"].values, turned["where"].values
    return scenes


def snapshots_shown(count: int, seconds: float) -> NDArray[np.int_]:
    """Return which of so many snapshots each frame shows, counted from 0.

    A frame shows a snapshot as it is: between two of them the run knows no place. All are shown
    for equally many frames, at most for a second; where there are more than frames some are left
    out.
    """
    frames = max(int(seconds * RATE), 2)
    shown = np.linspace(0, count - 1, min(frames, count)).round().astype(int)
    return np.repeat(shown, min(max(frames // shown.size, 1), RATE))


class Stage:
    """A figure whose artists are moved from frame to frame."""

    def __init__(self, scenes: Scenes) -> None:
        """Draw the fixed artists, and make those that move."""
        self.scenes = scenes
        step = float(np.diff(scenes.times).min(initial=1.0))
        self.decimals = max(2, 1 - math.floor(math.log10(step or 1.0)))
        self.figure: Figure = style.figure(8.0, 4.8)
        table_axes, below = self.figure.subplots(2, 1, height_ratios=(2.2, 1.0))
        draw_table(table_axes, scenes.circuit)
        half1, reach = 0.5 * scenes.circuit.channel1_width, 0.5 * scenes.circuit.channel1_length
        self.flashes = [
            table_axes.add_patch(
                Rectangle((left, -half1), reach, 2.0 * half1, fc=style.VERMILION, alpha=0.0, lw=0)
            )
            for left in (-reach, 0.0)
        ]
        self.dots = table_axes.scatter(
            scenes.snapshots[0].x, scenes.snapshots[0].y, s=4, lw=0, zorder=3
        )
        self.title = table_axes.set_title(" ", loc="center")
        self._draw_histories(below)
        self.now = below.axvline(scenes.times[0], color=style.BLACK, lw=0.8)
        self.moving = [*self.flashes, self.dots, self.title, self.now]
        self.figure.set_dpi(DOTS)
        self.figure.canvas.draw()  # places the axes
        self.figure.set_layout_engine("none")
        for artist in self.moving:
            artist.set_animated(True)
        self.figure.canvas.draw()
        self.background = self.figure.canvas.copy_from_bbox(self.figure.bbox)
        # Writers of films call this; all but the moving artists stays as it is drawn.
        self.figure.savefig = lambda file, **_: file.write(self.figure.canvas.buffer_rgba())

    def _draw_histories(self, below: object) -> None:
        scenes = self.scenes
        total = scenes.snapshots[0].x.size
        times = scenes.times
        alone = scenes.circuit.shape == "urn"  # which has no chi
        if alone:
            drawn = [np.count_nonzero(counted_by(scenes.circuit, one)) for one in scenes.snapshots]
        else:
            drawn = [abs(total - 2 * np.count_nonzero(one.x < 0.0)) / total
                     for one in scenes.snapshots]  # fmt: skip
        shown = [times[0], times[-1]]
        # round the circuit, as in the figure of flows, or out of the single urn
        ahead, back, name = ("1_12", "1_21", "1") if alone else ("2_21", "2_12", "2\nurn 2 → 1")
        if scenes.series is not None:
            inside = scenes.series.sel(time=slice(times[0], times[-1]))
            if inside.sizes["time"] > 2:
                if not alone:
                    drawn = np.abs(total - 2.0 * inside["urn1_number"].values) / total
                    times = inside["time"].values
                net = (inside[f"flow{ahead}"] - inside[f"flow{back}"]).values
                middle, mean, _ = binned(inside["middle"].values, net, 40)
                right = below.twinx()
                right.axhline(0.0, color=style.GREY, lw=0.5)
                right.plot(middle, mean, color=style.ORANGE, lw=0.9)
                right.set_ylabel(f"net current {name}\n(per unit time)", color=style.ORANGE)
                most = max(float(mean.max()), 1e-9)
                right.set_ylim(min(0.0, 1.1 * float(mean.min())), 1.1 * most)
        below.plot(times, drawn, color=style.BLUE, lw=1.1)
        label = "counted\nby the gate" if alone else r"mass spread $\chi$"
        below.set_ylabel(label, color=style.BLUE)
        below.set_ylim(0.0, 1.02 * max(*drawn, 1) if alone else 1.02)
        below.set_xlim(*shown)
        below.set_xlabel("time $t$  (length / $v$)")

    def show(self, snapshot: Snapshot, flash_time: float) -> None:
        """Draw the frame of a snapshot; a reversal is seen for `flash_time` after it."""
        scenes, time = self.scenes, snapshot.time
        counted = counted_by(scenes.circuit, snapshot) > 0
        colour = np.where(snapshot.x < 0.0, style.SKY, style.GREEN)
        self.dots.set_offsets(np.column_stack([snapshot.x, snapshot.y]))
        self.dots.set_facecolor(np.where(counted, style.VERMILION, colour))
        self.dots.set_sizes(np.where(counted, 16.0, 4.0))
        when, gate = scenes.reversals
        for number, flash in enumerate(self.flashes, start=1):
            ago = time - when[(gate == number) & (when <= time)]
            fade = 1.0 - float(ago.min(initial=np.inf)) / flash_time
            flash.set_alpha(0.6 * max(fade, 0.0))
        first = int(np.count_nonzero(snapshot.x < 0.0))
        numbers = f"    $N_1 = {first}$    $N_2 = {snapshot.x.size - first}$"
        self.title.set_text(
            f"$t = {time:.{self.decimals}f}$    $T = {scenes.circuit.thresholds}$"
            + numbers * (scenes.circuit.shape == "circuit")
        )
        self.now.set_xdata([time, time])
        canvas = self.figure.canvas
        canvas.restore_region(self.background)
        for artist in self.moving:
            artist.axes.draw_artist(artist)


@style.settings()
def write(scenes: Scenes, seconds: float, path: Path) -> None:
    """Write a film of at most `seconds`, an MP4 (H.264) or a GIF, which has every second frame."""
    stage, shown = Stage(scenes), snapshots_shown(len(scenes.snapshots), seconds)
    flash_time = min(FLASH * float(np.diff(scenes.times[shown]).max()), LONGEST_FLASH)
    if path.suffix == ".gif":
        shown, writer = shown[::2], PillowWriter(fps=RATE / 2)
    else:
        ffmpeg = cli.extra("film", "imageio_ffmpeg")
        mpl.rcParams["animation.ffmpeg_path"] = ffmpeg.get_ffmpeg_exe()
        writer = FFMpegWriter(
            fps=RATE, codec="libx264", extra_args=ENCODED, metadata={"comment": cli.MARK}
        )
    try:
        with cli.replaced(path) as half:
            with writer.saving(stage.figure, half, DOTS):
                for index in each(shown, "frame"):
                    stage.show(scenes.snapshots[index], flash_time)
                    writer.grab_frame()
            if path.suffix == ".gif":  # a comment before its last byte
                with half.open("r+b") as file:
                    file.seek(-1, os.SEEK_END)
                    file.write(b"!\xfe%c%b\x00;" % (len(cli.MARK), cli.MARK.encode()))
    except subprocess.CalledProcessError as problem:
        lines, full = problem.stderr.splitlines() or ["ffmpeg failed"], os.strerror(errno.ENOSPC)
        reason = next((one for one in lines if full in one), lines[-1])
        raise cli.InputError(f"cannot write {path}: {reason}") from problem


def film(
    results: str | Path | xr.Dataset,
    file: str | Path = "film.mp4",
    *,
    point: int | None = None,
    replica: int | None = None,
    seconds: float = SECONDS,
    verify: bool = False,
) -> Path:
    """Make a film of one task from its snapshots; return its path.

    Parameters
    ----------
    results
        A results file, or a dataset of `open_results`.
    file
        Path of the film: `.mp4`, or `.gif`, which has every second frame.
    point, replica
        Of the task, from 0; None: the first that is complete.
    seconds
        Length of the film, at most.
    verify
        Whether to read the file as a whole and check its digest.

    Returns
    -------
    pathlib.Path
        The film.

    Raises
    ------
    InputError
        There are fewer than two snapshots, the film cannot be written, or imageio-ffmpeg, which an
        MP4 needs, is not installed.

    Examples
    --------
    >>> print(film("map.h5", "film.gif", point=0, seconds=0.5))
    film.gif
    """
    if not (isinstance(seconds, (int, float)) and 0.0 < seconds <= 3600.0):
        raise cli.InputError(f"seconds = {seconds} must lie above 0 and up to 3600")
    points = by_point(dataset_of(results, verify=verify))
    scenes = read_scenes(points, *task_of(points, point, replica))
    say(points, remark(points))
    path = cli.path_of(file, "file")
    if path.suffix not in (".mp4", ".gif"):
        raise cli.InputError(f"{path}: a film is an .mp4 or a .gif")
    cli.file_to_write(path, path.suffix[1:])
    cli.output_folder(path.parent)
    write(scenes, seconds, path)
    return path
