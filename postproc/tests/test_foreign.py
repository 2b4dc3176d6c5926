"""Results files of strangers, sealed like our own: refused in one line; nothing in them runs."""

from __future__ import annotations

import re
import shutil
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest
from selenium import webdriver

from postproc import open_results
from postproc.cli import InputError
from postproc.reading import layout
from postproc.reading.layout import DATASETS, ROOT_TEXTS
from postproc.report import page as report_page
from postproc.tests.commands import call
from postproc.tests.runs import edited, results_of

if TYPE_CHECKING:
    from collections.abc import Callable

SECRET = b"only for its owner, these sixty-four bytes of a file beside it. "
BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
# Each sets the title of the page when it runs.
SCRIPTS = (
    '<img/src="x"onerror="document.title=\'run\'">',
    "<script>document.title='run'</script>",
    "</script><script>document.title='run'</script>",
    "</pre></main><script>document.title='run'</script>",
    "<svg/onload=\"document.title='run'\">",
)
# Texts of the root that the page shows, or may show some day.
SHOWN = ("namelist", "compiler", "created", "mpi_library", "git_commit")


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return results_of(
        tmp_path_factory.mktemp("ours") / "run.h5",
        particles={"number": 60},
        gate={"threshold": 2},
        run={"duration": 60.0},
        scan={"threshold": None, "channel2_width": [0.01, 0.1], "replicas": 2},
        output={"final_state": True},
    )


@pytest.fixture
def theirs(ours: Path, tmp_path: Path) -> Path:
    (tmp_path / "secret").write_bytes(SECRET)
    shutil.copy(ours, tmp_path / "others.h5")
    return Path(shutil.copy(ours, tmp_path))


def test_layout_is_what_the_program_writes(ours: Path, tmp_path: Path) -> None:
    """Nothing that is written lacks in the list, and nothing is in the list that none writes."""
    events = results_of(
        tmp_path / "events.h5",
        scan=dict.fromkeys(("threshold", "replicas")),
        gate={"threshold": 7},
        output={"event_log": True},
    )
    precise = results_of(
        tmp_path / "precise.h5",
        run={"duration": 50.0},
        scan={"threshold": [3, 7], "replicas": 16},
        precision={"chi_replica_error": 0.5},
    )
    names: set[str] = set()
    for path in (ours, events, precise):
        with h5py.File(path) as file:
            file.visititems(
                lambda name, one: names.add(name) if isinstance(one, h5py.Dataset) else None
            )
            assert set(file.attrs) - ROOT_TEXTS == {"mpi_ranks", "start_time"}
    unscanned = {name for name in DATASETS if name.startswith("scan/")}
    assert names - unscanned == set(DATASETS) - unscanned


def outside(file: h5py.File, name: str, secret: Path) -> None:
    """Put a dataset whose bytes are those of another file in the place of one of ours."""
    old = file[name]
    shape, dtype = old.shape, old.dtype
    del file[name]
    file.create_dataset(name, shape, dtype, external=[(str(secret), 0, h5py.h5f.UNLIMITED)])


def virtual(file: h5py.File, name: str, secret: Path) -> None:
    """Do the same by a virtual dataset."""
    shape = file[name].shape
    del file[name]
    layout = h5py.VirtualLayout(shape, "f8")
    layout[...] = h5py.VirtualSource(str(secret), "chi", shape)
    file.create_virtual_dataset(name, layout)


def replaced(file: h5py.File, name: str, **created: object) -> None:
    """Make a dataset anew, in another way."""
    del file[name]
    file.create_dataset(name, **created)


def bomb(file: h5py.File, name: str) -> None:
    """Store a dataset as a piece that grows to 256 MB when it is read.

    One megabyte is deflated, and repeated: its end is made to refer to nothing before it.
    """
    shape = file[name].shape
    replaced(file, name, shape=shape, dtype="f8", chunks=shape, compression="gzip")
    deflate = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    part = deflate.compress(bytes(1 << 20)) + deflate.flush(zlib.Z_FULL_FLUSH)
    check = (((1 << 28) % 65521 << 16) | 1).to_bytes(4, "big")  # Adler's, of zeros
    piece = b"\x78\xda" + 256 * part + deflate.flush() + check
    file[name].id.write_direct_chunk((0,) * len(shape), piece)


def stored(file: h5py.File, name: str, piece: bytes, left_out: int = 0) -> None:
    """Store a dataset as one piece, deflated unless its filter is left out."""
    shape, dtype = file[name].shape, file[name].dtype
    replaced(file, name, shape=shape, dtype=dtype, chunks=shape, compression="gzip")
    file[name].id.write_direct_chunk((0,) * len(shape), piece, left_out)


def spoilt(file: h5py.File, name: str) -> None:
    """Store a dataset as a piece that cannot be inflated."""
    stored(file, name, b"spoilt")


def short(file: h5py.File, name: str, left_out: int = 0) -> None:
    """Store a dataset as a piece that lacks its last value: HDF5 would read beyond its end."""
    piece = file[name][:].tobytes()[: -file[name].dtype.itemsize]
    stored(file, name, piece if left_out else zlib.compress(piece), left_out)


def linked(file: h5py.File, name: str, link: object) -> None:
    """Put a link in the place of a dataset."""
    del file[name]
    file[name] = link


EDITS: dict[str, tuple[str, Callable[[h5py.File, Path], None]]] = {
    "external storage": ("chi", lambda file, secret: outside(file, "chi", secret)),
    "virtual dataset": ("chi", lambda file, secret: virtual(file, "chi", secret)),
    # Whoever followed these links would find what fits.
    "external link": ("chi is a link", lambda file, secret: linked(
        file, "chi", h5py.ExternalLink(str(secret.with_name("others.h5")), "/chi"))),
    "soft link": ("chi is a link", lambda file, _: linked(
        file, "chi", h5py.SoftLink("/current1"))),
    "group by a link": ("final is a link", lambda file, secret: linked(
        file, "final", h5py.ExternalLink(str(secret.with_name("others.h5")), "/final"))),
    "a group for a dataset": ("chi", lambda file, _: (
        file.__delitem__("chi"), file.create_group("chi"))),
    "another filter": ("chi", lambda file, _: replaced(
        file, "chi", data=np.zeros((2, 2)), compression="lzf")),
    "named type": ("chi", lambda file, _: (
        file.__setitem__("t", np.dtype("f8")), replaced(file, "chi", shape=(2, 2), dtype=file["t"]),
        file.__delitem__("t"))),
    "text for numbers": ("chi", lambda file, _: replaced(file, "chi", data=[[b"a", b"b"]] * 2)),
    "references": ("chi", lambda file, _: replaced(
        file, "chi", shape=(2, 2), dtype=h5py.regionref_dtype)),
    "shorter": ("series/flow1_12", lambda file, _: replaced(
        file, "series/flow1_12", data=np.zeros((2, 2, 3)))),
    "huge": ("series/time", lambda file, _: replaced(
        file, "series/time", shape=(2**40,), dtype="f8")),
    "huge pieces": ("chi", lambda file, _: replaced(
        file, "chi", shape=(2, 2), maxshape=(None, None), chunks=(2**10, 2**14), dtype="f8")),
    "a piece that grows": ("chi", lambda file, _: bomb(file, "chi")),
    "a piece that is no deflated one": ("chi", lambda file, _: spoilt(file, "chi")),
    "one of what is read first": ("task_status", lambda file, _: spoilt(file, "task_status")),
    "a piece too short": ("chi has pieces", lambda file, _: short(file, "chi")),
    "a piece too short, as it is": ("chi has pieces", lambda file, _: short(file, "chi", 1)),
    "no particles": ("number", lambda file, _: file["number"].__setitem__(..., 0)),
    "a width that is none": ("channel1_width", lambda file, _: (
        file["channel1_width"].__setitem__(..., np.nan))),
    "sides that are no number": ("urn_sides", lambda file, _: file.attrs.update(
        urn_shape="polygon", urn_sides=np.nan)),
    "sides without end": ("urn_sides", lambda file, _: file.attrs.update(
        urn_shape="polygon", urn_sides=np.inf)),
    "a time without end": ("series/time", lambda file, _: (
        file["series/time"].__setitem__(-1, np.inf))),
    "unknown name": ("<b>", lambda file, _: file.__setitem__("<b>", 1.0)),
    "unknown attribute": ("colour", lambda file, _: file.attrs.__setitem__("colour", "red")),
    "many texts": ("version", lambda file, _: file.attrs.__setitem__("version", ["0.2.0"] * 9)),
    "escape in a unit": ("units", lambda file, _: (
        file["chi"].attrs.__setitem__("units", "\x1b[31m"))),
}  # fmt: skip


@pytest.mark.parametrize("edit", EDITS)
def test_what_the_program_does_not_write_is_refused(theirs: Path, edit: str) -> None:
    """The message names file and dataset."""
    named, change = EDITS[edit]
    with edited(theirs) as file:
        change(file, theirs.parent / "secret")
    with pytest.raises(InputError, match=f"{theirs.name}.*{named}"):
        open_results(theirs)


@pytest.mark.parametrize("group", [None, "snapshots"])
def test_what_is_read_together_fits_into_memory(
    theirs: Path, monkeypatch: pytest.MonkeyPatch, group: str | None
) -> None:
    """Datasets none of which is large may be too large together, in a file of a few kB."""
    with edited(theirs) as file:
        if group is None:
            for name in ("series", "snapshots", "final"):
                del file[name]
        columns = file[group or "/"].values()
        sizes = [one.nbytes for one in columns if isinstance(one, h5py.Dataset)]
    monkeypatch.setattr(layout, "memory_left", lambda: max(sizes))
    needs = re.escape(f"{theirs.name}: needs {sum(sizes):.3g} bytes of memory")
    with pytest.raises(InputError, match=needs):
        open_results(theirs, group=group)


def test_error_lines_have_no_escape_sequences(
    theirs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with edited(theirs) as file:
        file.attrs["version"] = "\x1b]0;owned\x07"
    assert call("report", [str(theirs)]) == 2
    said = capsys.readouterr().err
    assert "\\x1b]0;owned\\x07" in said
    assert said.isascii()
    assert "\x1b" not in said


def test_dimensions_are_those_of_the_list(theirs: Path) -> None:
    """What a file says of its dimensions by references is not followed."""
    with open_results(theirs) as right, edited(theirs) as file:
        for name in ("chi", "series/urn1_number"):
            if "DIMENSION_LIST" in (group := file[name]).attrs:
                del group.attrs["DIMENSION_LIST"]
    assert open_results(theirs).identical(right)


def with_scripts(path: Path) -> list[Path]:
    """Write files with scripts wherever a text or a name can be; those that are refused as well."""
    made = []
    for at, script in enumerate(SCRIPTS):
        for where in (*SHOWN, "version", "scan"):
            one = Path(shutil.copy(path, path.with_name(f"{where}{at}.h5")))
            with edited(one) as file:
                if where == "scan":
                    file.attrs["scan"] = script
                    file["scan"].require_group(script.rpartition("/")[0] or ".")
                    file["scan"].move("channel2_width", script)
                else:
                    file.attrs[where] = ("0.2." if where == "version" else "") + script
            made.append(one)
    return made


@pytest.mark.full
def test_no_script_of_a_file_runs_in_its_page(
    theirs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In Chromium: texts are escaped; where one is not, the page's policy stops it."""
    if not (BROWSER and DRIVER):
        pytest.skip("no chromium and chromium-driver here")
    pages = []
    for path in with_scripts(theirs):
        code = call("report", [str(path), "--output", str(theirs.parent), "--model", "window"])
        assert code == (2 if path.stem.startswith(("scan", "version")) else 0)
        pages += [path.with_suffix(".html")] if code == 0 else []
    # The policy alone: a template that has forgotten to escape.
    template = report_page.HERE / "page.html"
    monkeypatch.setattr(report_page, "HERE", theirs.parent)
    text = template.read_text(encoding="utf-8").replace("{{ namelist | e }}", "{{ namelist }}")
    (theirs.parent / "page.html").write_text(text, encoding="utf-8")
    for at in range(len(SCRIPTS)):
        one = theirs.with_name(f"namelist{at}.h5")
        assert call("report", [str(one), "--output", str(theirs.parent / "bare")]) == 0
        pages.append(theirs.parent / "bare" / f"{one.stem}.html")
    assert len(pages) >= 20
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for word in ("--headless=new", "--no-sandbox", "--disable-gpu"):
        options.add_argument(word)
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    try:
        for one in pages:
            driver.get(one.as_uri())
            driver.set_script_timeout(20)
            ready = driver.execute_async_script(
                "const done = arguments[0]; const look = () => "
                "(window.Bokeh?.documents[0]?.is_idle ? done(true) : setTimeout(look, 50)); look()"
            )
            assert ready
            assert driver.title == f"{one.stem}.h5"
    finally:
        driver.quit()
