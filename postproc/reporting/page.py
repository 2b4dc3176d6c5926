"""One self-contained HTML page about a run, made with Bokeh, which is in the page itself."""

from __future__ import annotations

import base64
import hashlib
import html
import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from bokeh.document import Document
from bokeh.embed import file_html
from bokeh.models import (
    Axis,
    CDSView,
    ColorBar,
    ColumnDataSource,
    CustomJS,
    DataTable,
    Div,
    HoverTool,
    IndexFilter,
    InlineStyleSheet,
    Legend,
    Line,
    LinearColorMapper,
    PreText,
    Segment,
    Select,
    TableColumn,
    TapTool,
    Title,
)
from bokeh.plotting import figure
from bokeh.resources import Resources

from postproc.cli import MARK
from postproc.figures import style
from postproc.figures.maps import colours_of
from postproc.figures.scene import draw_table
from postproc.figures.style import CYCLE
from postproc.reading.points import keys_of, of_files, second_values, with_first, with_tasks
from postproc.reporting import data
from postproc.reporting.warn import explanations, warnings
from postproc.theory.models import left_out

if TYPE_CHECKING:
    from collections.abc import Iterable

    import xarray as xr
    from bokeh.model import Model as BokehModel
    from numpy.typing import NDArray

    from postproc.reporting.data import Columns, Scan
    from postproc.theory.circuit import Circuit
    from postproc.theory.model import Model

    Floats = NDArray[np.float64]

HERE = Path(__file__).parent
# At this level the library prints no message on the console.
SILENT = ('Bokeh.set_log_level("warn")', 'Bokeh.logger.set_level("warn")')
SCRIPTS = "SCRIPTS-OF-THE-PAGE"  # placeholder in the template for their digests
IDLE = "Put the mouse on a point; click one to see its replicas."
PALETTES = {"chi": "Viridis256", "current": "Inferno256"}
ERRORS = "Cividis256"
KEPT = ("version", "git_commit", "created", "status", "mpi_ranks", "mpi_library", "compiler")
KNOWN = "Theory: the stable state that its drift reaches from the start of the runs."
UNKNOWN = "Theories beside it would be of equal urns and gates, without scatterers: none is shown."
SHOWN = ("number", "threshold", "channel1_width", "channel1_length", "channel2_width",
         "channel2_length")  # fmt: skip
LEFT_OUT = (
    "told",
    "left",
    "right",
    "bottom",
    "top",
    "chi_low",
    "chi_high",
    "current_low",
    "current_high",
)  # columns of the points that are for the pictures alone
THEORY_MARKS = ("x", "cross", "y")  # at the points, since nothing is computed between them
MOST = 6  # replicas that have a colour and a name each; of more the mean is drawn before them
DOTS = 110  # per inch, in the picture of the table
HOVERED = """
const [at] = cb_data.index.indices
reading.text = at === undefined ? idle : points.data.told[at]
"""
CHOSEN = """
for (const [source, shown] of [[points, cells], [lines, drawn]]) {
  const fits = (_, at) => keys.every((key, k) => source.data[key][at] === +choices[k].value)
  shown.indices = Array.from({length: source.get_length() ?? 0}, (_, at) => at).filter(
    (at) => fits(null, at))
}
"""
CLICKED = """
const [at] = points.selected.indices
if (at === undefined) return
name.text = `Point ${at}. ${points.data.told[at]}`
const tasks = Array.from({length: count}, (_, replica) => at * count + replica)
rows.indices = tasks
namelist.text = text.replace(/'@(\\w+)@'/g, (_, key) => String(values[key][at]))
if (time.length === 0) return
const kept = tasks.filter((task) => tasks_with_series[task])
const cut = (values) => kept.map(
  (task) => Array.from(values.slice(task * time.length, (task + 1) * time.length)))
const average = (values) => values.reduce((sum, one) => sum + one, 0) / values.length
const known = (all, k) => all.map((one) => one[k]).filter((one) => !Number.isNaN(one))
const mean = (all) => time.map((_, k) => average(known(all, k)))
const deviation = (all) => time.map((_, k) => {
  const [values, middle] = [known(all, k), average(known(all, k))]
  const squares = values.map((one) => (one - middle) ** 2)
  return Math.sqrt(average(squares) * values.length / Math.max(values.length - 1, 1))
})
const grey = kept.length > most
const many = grey && !apart[at]
const with_mean = (all) => many ? [...all, mean(all)] : all
const named = kept.map((task) => `replica ${task % count}`)
const edges = {time: many ? time : []}
for (const name of ['spread', 'current']) {
  const all = cut(series.data[name])
  const [middle, width] = many ? [mean(all), deviation(all)] : [[], []]
  edges[`${name}_low`] = middle.map((one, k) => one - width[k])
  edges[`${name}_high`] = middle.map((one, k) => one + width[k])
}
band.data = edges
shown.data = {
  time: with_mean(cut(series.data.spread)).map(() => time),
  spread: with_mean(cut(series.data.spread)),
  current: with_mean(cut(series.data.current)),
  colour: [...kept.map((task) => grey ? '#9ab' : colours[(task % count) % colours.length]),
    ...(many ? ['#d55e00'] : [])],
  width: [...kept.map(() => grey ? 0.5 : 1.2), ...(many ? [2.5] : [])],
  replica: [...named, ...(many ? ['mean'] : [])],
}
"""
THEMED = """
const theme = matchMedia('(prefers-color-scheme: dark)')
const paint = () => {
  const style = getComputedStyle(document.documentElement)
  for (const [name, drawn] of [['--ink', inks], ['--paper', papers]]) {
    for (const [model, property] of drawn) model[property] = style.getPropertyValue(name).trim()
  }
}
theme.addEventListener('change', paint)
paint()
"""
TABLES = """
.slick-header, .slick-header-column.ui-state-default, .slick-row, .slick-cell {
  background: var(--paper) !important; color: var(--ink); border-color: var(--shade) !important }
.slick-row.odd .slick-cell { background: var(--shade) !important }
.slick-cell.selected { background: var(--chosen) !important }
"""
CHOICES = """
.bk-input { background-color: var(--paper); color: var(--ink); border-color: var(--rule) }
"""


@dataclass
class Page:
    """The parts of a page, which share their points."""

    given: xr.Dataset
    scan: Scan
    models: dict[str, Model]
    columns: Columns

    def __post_init__(self) -> None:
        """Put the columns into sources of the library."""
        self.points = ColumnDataSource(self.columns)
        first = int(self.given["complete"].any("replica").values.argmax())
        self.points.selected.indices = [first]
        self.cells = IndexFilter(list(range(self.given.sizes["point"])))
        self.lines = ColumnDataSource(data.map_lines(self.given, self.scan, self.models))
        self.drawn = IndexFilter(list(range(len(self.lines.data["xs"]))))
        self.reading = Div(text=IDLE, name="reading", render_as_text=True)
        self.urn = self.given.attrs.get("shape") == "urn"
        self.measured = {name: title
                         for name, title in (data.OF_URN if self.urn else data.MEASURED).items()
                         if np.isfinite(self.columns[name]).any()}  # fmt: skip

    def panels(self) -> list[figure]:
        """Return the maps of a scan, or its curves; none for a single point."""
        if self.scan.up:
            made = [self._map(name, error) for error in ("", "_error") for name in self.measured]
        elif self.scan.across:
            made = [self._curve(name) for name in self.measured]
        else:
            made = []
        for other in made[1:]:
            other.x_range = made[0].x_range
            if self.scan.up:
                other.y_range = made[0].y_range
        return made

    def _figure(self, name: str, title: str, **ranges: object) -> figure:
        made = figure(
            name=name,
            title=title,
            height=360,
            min_width=280,
            sizing_mode="stretch_width",
            tools="box_zoom,wheel_zoom,reset,save",
            x_axis_label=data.label(self.scan.across),
            **ranges,
        )
        made.toolbar.logo = None
        made.grid.visible = False
        return made

    def _mouse(self, made: figure, marks: BokehModel) -> None:
        callback = CustomJS(
            args={"reading": self.reading, "points": self.points, "idle": IDLE}, code=HOVERED
        )
        made.add_tools(HoverTool(renderers=[marks], tooltips=None, callback=callback))
        made.add_tools(TapTool(renderers=[marks]))

    def _map(self, name: str, error: str) -> figure:
        made = self._figure(
            f"{name}{error}",
            f"{self.measured[name]}{error.replace('_', ', ')}",
            x_range=(self.columns["left"].min(), self.columns["right"].max()),
            y_range=(self.columns["bottom"].min(), self.columns["top"].max()),
        )
        values = self.columns[f"{name}{error}"]
        low, high = (0.0, 1.0) if name == "chi" and not error else colours_of(values)
        mapper = LinearColorMapper(
            palette=ERRORS if error else PALETTES[name], low=low, high=high, nan_color="#d0d0d0"
        )
        outline = {"line_color": "white", "line_width": 3}
        cells = made.quad(
            left="left", right="right", bottom="bottom", top="top", source=self.points,
            view=CDSView(filter=self.cells), line_color=None,
            fill_color={"field": f"{name}{error}", "transform": mapper},
        )  # fmt: skip
        cells.nonselection_glyph = None
        cells.selection_glyph = cells.glyph.clone(line_color="#ff3030", line_width=3)
        cells.hover_glyph = cells.glyph.clone(**outline)
        for colour, width in (("black", 3.0), ("white", 1.6)):
            made.multi_line(
                "xs", "ys", source=self.lines, view=CDSView(filter=self.drawn),
                line_color=colour, line_width=width, line_dash="dash",
            )  # fmt: skip
        made.add_layout(ColorBar(color_mapper=mapper, width=10, padding=4), "right")
        made.yaxis.axis_label = data.label(self.scan.up)
        self._mouse(made, cells)
        return made

    def _curve(self, name: str) -> figure:
        known = [self.columns[key] for key in (name, f"{name}_low", f"{name}_high",
                 *(f"{model}_{name}" for model in self.models)) if key in self.columns]  # fmt: skip
        low, high = float(np.nanmin(known)), float(np.nanmax(known))
        more = 0.05 * (high - low) or 0.05
        made = self._figure(
            name, f"{self.measured[name]}, standard errors", y_range=(low - more, high + more)
        )
        across = self.scan.across
        chosen = {"source": self.points, "view": CDSView(filter=self.cells)}
        for model, mark in zip(self.models, THEORY_MARKS, strict=False):
            if f"{model}_{name}" in self.columns:
                theory = made.scatter(
                    across, f"{model}_{name}", size=10, marker=mark,
                    line_color="#333333", line_width=1.5, **chosen,
                )  # fmt: skip
                theory.nonselection_glyph = None
        errors = made.segment(across, f"{name}_low", across, f"{name}_high", **chosen)
        errors.nonselection_glyph = None
        marks = made.scatter(across, name, size=9, color=CYCLE[0], **chosen)
        marks.nonselection_glyph = None
        marks.selection_glyph = marks.glyph.clone(fill_color=CYCLE[1], line_color=CYCLE[1], size=12)
        marks.hover_glyph = marks.glyph.clone(fill_color=CYCLE[4], line_color="black", size=13)
        self._mouse(made, marks)
        return made

    def choices(self) -> list[Select]:
        """Return the selectors of the keys that are on no axis."""
        made = []
        for name in self.scan.others:
            options = [str(one) for one in np.unique(self.columns[name])]
            made.append(
                Select(title=data.label(name), value=options[0], options=options,
                       name=f"choice_{name}", stylesheets=[InlineStyleSheet(css=CHOICES)])
            )  # fmt: skip
        self.choose = CustomJS(
            args={"points": self.points, "cells": self.cells, "lines": self.lines,
                  "drawn": self.drawn, "keys": self.scan.others, "choices": made},
            code=CHOSEN,
        )  # fmt: skip
        for one in made:
            one.js_on_change("value", self.choose)
        return made

    def table(self) -> DataTable:
        """Return the table of all points, which sorts."""
        heads = {name: data.label(name) for name in self.scan.keys | self.scan.unequal}
        if not self.urn:
            heads["start"] = "start chi"
        for name in self.measured:
            heads |= {name: name, f"{name}_error": f"{name} error"}
            heads |= {f"{key}_{name}": f"{name}, {key}" for key in self.models
                      if f"{key}_{name}" in self.columns}  # fmt: skip
        heads["tasks"] = "tasks"
        return _table("points", self.points, heads, rows=min(self.given.sizes["point"], 16))

    def detail(self) -> list[BokehModel]:
        """Return the parts that a click fills: a line, the replicas, their series, a namelist."""
        replicas = data.replicas_of(self.given)
        tasks = ColumnDataSource(replicas)
        time, columns = data.thinned_series(self.given)
        rows, count = IndexFilter([]), self.given.sizes["replica"]
        table = _table("replicas", tasks, {name: name for name in replicas}, rows=min(count, 8),
                       widths=WIDTHS, view=CDSView(filter=rows))  # fmt: skip
        shown = ColumnDataSource(
            {key: [] for key in (*SERIES, "time", "colour", "replica", "width")}
        )
        band = ColumnDataSource(
            {"time": [], **{f"{key}_{end}": [] for key in SERIES for end in ("low", "high")}}
        )
        name, namelist = Div(name="name", render_as_text=True), PreText(name="namelist")
        text, values = data.namelist_of_point(self.given)
        there = np.isfinite(columns.get("spread", np.empty(0)).reshape(-1, max(time.size, 1)))
        self.click = CustomJS(
            args={"points": self.points, "name": name, "rows": rows, "count": count,
                  "namelist": namelist, "text": text,
                  "values": {key: one.tolist() for key, one in values.items()},
                  "time": time.tolist(), "series": ColumnDataSource(columns), "shown": shown,
                  "band": band, "apart": self.given["two_states"].values.tolist(),
                  "tasks_with_series": there.any(axis=1).tolist(), "colours": list(CYCLE),
                  "most": MOST},
            code=CLICKED,
        )  # fmt: skip
        self.points.selected.js_on_change("indices", self.click)
        titles = data.OF_URN if self.urn else SERIES
        self.series = [self._series(shown, band, one, title, time, columns[one])
                       for one, title in titles.items() if columns]  # fmt: skip
        known = bool(self.given.attrs.get("namelist"))
        return [name, table, *self.series, *[namelist] * known]

    def _series(
        self, shown: ColumnDataSource, band: ColumnDataSource, name: str, title: str, time: Floats,
        values: Floats,
    ) -> figure:  # fmt: skip
        known = values[np.isfinite(values)]
        low, high = known.min(initial=0.0), known.max(initial=0.0)
        many = self.given.sizes["replica"] > MOST
        made = self._figure(
            f"series_{name}",
            f"{title} (orange: mean and standard deviation of replicas)" if many else title,
            x_range=(0.0, time[-1]),
            y_range=(low, 1.0 if name == "spread" or low == high else high),
        )
        made.height, made.xaxis.axis_label = 240, "time t (length / v)"
        made.multi_line("time", name, source=shown, line_color="colour", line_width="width",
                        legend_field="replica")  # fmt: skip
        made.varea("time", f"{name}_low", f"{name}_high", source=band, fill_color="#d55e00",
                   fill_alpha=0.25)  # fmt: skip
        made.legend.visible = 1 < self.given.sizes["replica"] <= MOST
        made.legend.label_text_font_size = "8pt"
        made.legend.background_fill_alpha = 0.6
        return made


WIDTH_OF_NUMBER, WIDTH_OF_LETTER = 84, 7  # pixels, in a table
# Widths of the table of replicas: the sum fits on a telephone.
WIDTHS = {"replica": 48, "chi": 94, "current": 98, "collisions": 62, "seconds": 54}
# Properties of the parts of a figure that have the colour of the text, and of the page.
INKED = {
    Title: ("text_color",),
    Axis: ("axis_label_text_color", "major_label_text_color", "axis_line_color",
           "major_tick_line_color", "minor_tick_line_color"),
    Segment: ("line_color",), Line: ("line_color",),
    Legend: ("label_text_color",), ColorBar: ("major_label_text_color",),
}  # fmt: skip
PAPERED = {
    figure: ("background_fill_color", "border_fill_color"), Legend: ("background_fill_color",),
    ColorBar: ("background_fill_color",),
}  # fmt: skip
SERIES = {"spread": "mass spread chi", "current": "polarised current"}


def _table(
    name: str, source: ColumnDataSource, heads: dict[str, str], rows: int,
    widths: dict[str, int] | None = None, **more: object,
) -> DataTable:  # fmt: skip
    """Return a table; columns whose `widths` are given hold texts, which do not sort as numbers."""
    # Columns share the width by the lengths of their heads, so that no head is truncated.
    wide = widths or {key: max(WIDTH_OF_NUMBER, WIDTH_OF_LETTER * len(title) + 16)
                      for key, title in heads.items()}  # fmt: skip
    columns = [TableColumn(field=key, title=html.escape(title), width=wide[key],
                           sortable=widths is None)
               for key, title in heads.items()]  # fmt: skip
    return DataTable(
        name=name,
        source=source,
        columns=columns,
        index_position=None,
        reorderable=False,
        margin=0,
        height=28 * (rows + 1) + 16,
        min_width=sum(wide[key] for key in heads),
        sizing_mode="stretch_width",
        stylesheets=[InlineStyleSheet(css=TABLES)],
        **more,
    )


def themed(figures: list[figure]) -> CustomJS:
    """Return a script that gives figures, drawn on canvas, the colours of the page's theme."""
    parts = sorted(set().union(*(one.references() for one in figures)), key=lambda part: part.id)
    inks, papers = (
        [[part, name] for part in parts for kind, names in kinds.items() if isinstance(part, kind)
         for name in names] for kinds in (INKED, PAPERED)
    )  # fmt: skip
    return CustomJS(args={"inks": inks, "papers": papers}, code=THEMED)


def _run(points: xr.Dataset) -> dict[str, str]:
    known = points.attrs
    collisions, seconds = (float(points[name].sum()) for name in ("collisions", "cpu_seconds"))
    rows = {name.replace("_", " "): ", ".join(dict.fromkeys(of_files(points, name)))
            for name in KEPT if name in known}  # fmt: skip
    rows["tasks"] = f"{int(points['complete'].sum())} of {int(points['asked'].sum())} complete"
    rows["wall collisions"] = f"{collisions:.4g}"
    rows["processor time"] = f"{seconds:.4g} s"
    if seconds > 0.0:
        rows["speed"] = f"{collisions / seconds:.3g} collisions a second, one core"
    return rows


def _lines(parts: Page) -> str:
    if not parts.models or (parts.scan.up and not len(parts.lines.data["xs"])):
        return ""
    looks = map(data.dash, parts.models.values()) if parts.scan.up else THEORY_MARKS
    named = ", ".join(f"{one.label} ({look})"
                      for one, look in zip(parts.models.values(), looks, strict=False))  # fmt: skip
    what = "Lines, where the homogeneous state turns stable" if parts.scan.up else "Marks, theory"
    return f"{what}: {named}."


@style.settings()
def _picture(circuit: Circuit) -> str:
    """Return the table to scale as a PNG in base 64."""
    made = style.figure(style.PAGE, 2.6)
    draw_table(made.subplots(), circuit)
    with io.BytesIO() as file:
        made.savefig(file, format="png", dpi=DOTS)
        return base64.b64encode(file.getvalue()).decode("ascii")


def _about(points: xr.Dataset) -> str:
    """Return what all points have in common: parameters, replicas, the length of runs."""
    names = with_first([*SHOWN, *keys_of(points), *second_values(points)])
    columns = {name: points[name].values for name in names}
    if points.attrs.get("shape") != "urn":
        columns["chi at the start"] = points["start"].values
    told = [f"{data.SYMBOLS.get(name, name)} = {style.brief(values[0], 5)}"
            for name, values in columns.items() if np.unique(values).size == 1]  # fmt: skip
    replicas = _from_to(points["asked"].sum("replica").values)
    told.append(f"{replicas} {'replica' if replicas == '1' else 'replicas'}")
    if "time" in points:
        time = points["time"].values[points["complete"].values]
        told.append(f"runs of {_from_to(time)} time units")
    return ", ".join(told)


def _from_to(values: NDArray[np.generic]) -> str:
    """Return the least and the greatest value, one if they are equal."""
    return " to ".join(style.brief(one, 5) for one in np.unique([values.min(), values.max()]))


def _theory(circuits: Iterable[Circuit], models: dict[str, Model]) -> str:
    """Return how theories are shown, and what the default ones leave out."""
    remark = "" if "direction" in models else left_out(circuits)
    return KNOWN + (f" {remark.capitalize()}." if remark else "")


def page(points: xr.Dataset, models: dict[str, Model]) -> str:
    """Return the whole page, with theories by name; without them if none applies to the table."""
    circuits = with_tasks(points)["circuit"].values
    if all(one.beyond_theory for one in circuits):
        models = {}
    scan = data.scanned(points)
    parts = Page(points, scan, models, data.points_of(points, scan, models))
    panels, choices, detail = parts.panels(), parts.choices(), parts.detail()
    title = ", ".join(file.rpartition("/")[2] for file in of_files(points, "files"))
    document = Document(title=title)
    roots = [parts.reading] if panels else []
    with document.models.freeze():  # or the models of all roots are gathered anew with each root
        for one in (*roots, *choices, *panels, *detail, parts.table()):
            document.add_root(one)
    paint = themed([*panels, *parts.series])
    document.js_on_event("document_ready", paint, parts.choose, parts.click)
    csv = pd.DataFrame({name: values for name, values in parts.columns.items()
                        if name not in LEFT_OUT}).to_csv(index=False)  # fmt: skip
    made = file_html(
        document,
        Resources(mode="inline", log_level="warn"),
        title,
        template=(HERE / "page.html").read_text(encoding="utf-8"),
        template_variables={
            "mark": MARK,
            "about": _about(points),
            "warnings": warnings(points),
            "explanations": explanations(points),
            "lines": _lines(parts),
            "theory": UNKNOWN if not models else "" if parts.urn else _theory(circuits, models),
            "picture": _picture(circuits[0]),
            "panels": [one.name for one in panels],
            "choices": [one.name for one in choices],
            "series": [one.name for one in parts.series],
            "csv": base64.b64encode(csv.encode()).decode("ascii"),
            "run": _run(points),
            "namelist": str(points.attrs.get("namelist", "")),
        },
    )
    return _guarded(made.replace(*SILENT))


def _guarded(text: str) -> str:
    """Return a page in which only its own scripts run, by their digests.

    The scripts are before and after the contents, where there is no text of the results.
    """
    before, behind = text.partition("<main>")[0], text.rpartition("</main>")[2]
    scripts = [one for part in (before, behind)
               for one in re.findall(r"<script>(.*?)</script>", part, flags=re.S)]  # fmt: skip
    digests = (hashlib.sha256(one.encode()).digest() for one in scripts)
    allowed = " ".join(f"'sha256-{base64.b64encode(one).decode()}'" for one in digests)
    return text.replace(SCRIPTS, allowed, 1)
