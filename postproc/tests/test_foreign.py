"""Results files of strangers, and damaged ones: nothing in them runs, or leads out of them."""

from __future__ import annotations

import random
import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import pytest
import xarray as xr
from selenium import webdriver

from postproc import open_results
from postproc.cli import EXIT_BAD_INPUT, InputError
from postproc.reading import results_file, seal
from postproc.reporting import page as report_page
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


def endless(file: h5py.File, name: str) -> None:
    """Claim more values than there is memory for."""
    replaced(file, name, shape=(2**40, 2), dtype="f8", chunks=(1000, 2))
    for dimension, scale in zip(file[name].dims, ("point", "replica"), strict=True):
        dimension.attach_scale(file[scale])


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
    "more values than memory": ("bytes of memory", lambda file, _: endless(file, "chi")),
}  # fmt: skip


@pytest.mark.parametrize("edit", EDITS)
def test_what_leads_out_of_the_file_is_refused(theirs: Path, edit: str) -> None:
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
    monkeypatch.setattr(results_file, "memory_left", lambda: max(sizes))
    needs = re.escape(f"{theirs.name}: needs {sum(sizes):.3g} bytes of memory")
    with pytest.raises(InputError, match=needs):
        open_results(theirs, group=group)


def test_damage_is_an_error_or_not_noticed_and_verify_notices_all(
    ours: Path, tmp_path: Path
) -> None:
    """Any bytes may change, the seal's included: there is no other exception, and no crash."""
    whole, choice, seen = ours.read_bytes(), random.Random(5), []
    path = tmp_path / "damaged.h5"
    for _ in range(25):
        content = bytearray(whole)
        first, last = choice.choice([(0, 8_000), (0, len(whole)), (len(whole) - 520, len(whole))])
        at = choice.randrange(first, last - 8)
        content[at : at + 8] = choice.randbytes(8)
        path.write_bytes(content)
        for group in (None, "series", "final"):
            try:
                open_results(path, group=group)
            except InputError as problem:
                seen.append(str(problem))
        try:
            found = open_results(path, verify=True)
        except InputError as problem:
            seen.append(str(problem))
            assert call("plot", ["flows", str(path), "--verify"]) == EXIT_BAD_INPUT
        else:  # the rest of the seal proves that the data are whole
            assert at >= len(whole) - seal.LENGTH
            xr.testing.assert_equal(found, open_results(ours))
    assert len(seen) > 10
    assert all(path.name in one for one in seen)


def test_a_file_that_is_replaced_while_it_is_verified_is_whole(
    ours: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a run that grows does: the file that was opened is the one that is checked."""
    path, digest = tmp_path / "grown.h5", seal._digest
    path.write_bytes(ours.read_bytes())
    another = results_of(tmp_path / "another.h5", particles={"number": 10})

    def digest_late(*given: Any) -> str:
        another.replace(path)
        return digest(*given)

    monkeypatch.setattr(seal, "_digest", digest_late)
    seal.check_seal(path, verify=True)
    assert not another.exists()


@pytest.mark.parametrize(
    "content", [seal.FIRST_LINE.encode(), seal.seal_of(0, 64 * "0"), seal.MARK]
)
def test_a_piece_of_a_file_is_none_of_the_program(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "piece.h5"
    path.write_bytes(content)
    with pytest.raises(InputError, match="not an HDF5 file"):
        open_results(path)


@pytest.mark.parametrize("name", [".", "/", ".."])
def test_a_folder_is_no_file(name: str) -> None:
    with pytest.raises(InputError, match="is a folder, not a file"):
        open_results(name)


def test_of_a_run_that_goes_on_it_is_said_how_to_look_into_it(tmp_path: Path) -> None:
    (tmp_path / "out.h5.tasks").mkdir()
    with pytest.raises(InputError, match="its run goes on or was stopped: battery --partial"):
        open_results(tmp_path / "out.h5")


def test_a_file_that_was_copied_in_parts_is_one_line(ours: Path, tmp_path: Path) -> None:
    """HDF5 copies each dataset without the scales of its dimensions, which are others."""
    path = tmp_path / "parts.h5"
    with h5py.File(ours) as given, h5py.File(path, "w") as made:
        for name in given:
            given.copy(name, made)
        made.attrs.update(given.attrs)
    with pytest.warns(UserWarning, match="no digest"), pytest.raises(InputError, match="in parts"):
        open_results(path)


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


def with_scripts(path: Path) -> list[Path]:
    """Write files with scripts wherever a text or a name can be."""
    made = []
    for at, script in enumerate(SCRIPTS):
        for where in (*SHOWN, "version", "units", "scan"):
            one = Path(shutil.copy(path, path.with_name(f"{where}{at}.h5")))
            with edited(one) as file:
                if where == "scan":
                    file.attrs["scan"] = script
                    file["scan"].require_group(script.rpartition("/")[0] or ".")
                    file["scan"].move("channel2_width", script)
                elif where == "units":
                    file["chi"].attrs["units"] = file["chi"].attrs["long_name"] = script
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
        code = call("report", [str(path), "--output", str(theirs.parent), "--theory", "window"])
        assert code == 0 or path.stem.startswith("scan")
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
