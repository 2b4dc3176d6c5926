"""Makes the site: `make docs` calls it. All problems are listed, and then no site is made.

With `--dry` no block of the pages is executed: to see how they look. The generated parts, lists of
keys, results and options, are written into the pages themselves first, so that they can be read
there.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

from manual import fortran, pages, reference
from manual.fences import Fences

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "build/manual/source"
WORK = ROOT / "build/manual/work"
SITE = ROOT / "build/site"
# The public names of Python, from their docstrings.
PUBLIC = """# Names of Python

```{eval-rst}
.. automodule:: postproc
   :members:

.. automodule:: postproc.plot
   :members:
```
"""


def main() -> int:
    """Make all pages, then the site; return 1 if there is a problem."""
    begin = time.monotonic()
    for folder in (SOURCE, WORK, SITE):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
    api, problems = write_api()
    there = pages.pages(ROOT)
    made, wrong = reference.generated(ROOT, WORK)
    problems += wrong
    for name, file in there.items():
        before = (ROOT / file).read_text(encoding="utf-8")
        text = pages.filled(before, made | pages.tables(ROOT, file, before))
        if text != before:
            (ROOT / file).write_text(text, encoding="utf-8")
            print(f"{file}: its generated part was written anew")
        dry = "--dry" in sys.argv[1:]
        fences = Fences(ROOT, WORK / name, SOURCE / f"drawn_{name}", dry)
        text, wrong = pages.linked(ROOT, SOURCE, file, text)
        text = fences.shown(file, text)
        problems += wrong + fences.problems
        if name == "index":
            text += pages.contents(ROOT, api, there)
        (SOURCE / f"{name}.md").write_text(text, encoding="utf-8")
    for one in problems:
        print(one, file=sys.stderr)
    if problems:
        print(f"{len(problems)} problem(s): no site was made", file=sys.stderr)
        return 1
    if code := sphinx():
        return code
    size = sum(path.stat().st_size for path in SITE.rglob("*") if path.is_file())
    print(f"build/site/index.html: {size / 1e6:.1f} MB, {time.monotonic() - begin:.0f} s")
    return 0


def sphinx() -> int:
    """Make the site of the pages; a warning is an error."""
    for name in ("conf.py", "manual.css"):
        shutil.copyfile(Path(__file__).with_name(name), SOURCE / name)
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"]
    done = subprocess.run(
        [*command, "-d", str(WORK / "doctrees"), str(SOURCE), str(SITE)], check=False
    )
    if done.returncode:
        shutil.rmtree(SITE)
    else:
        (SITE / ".buildinfo").unlink(missing_ok=True)
        (SITE / "objects.inv").unlink(missing_ok=True)
    return done.returncode


def layers() -> dict[str, str]:
    """Return the layers of src with their meanings (docs/layers.txt)."""
    text = (ROOT / "docs/layers.txt").read_text().partition("\nsrc\n")[2]
    return dict(re.findall(r"^  (\w+) +(.*)", re.split(r"^\w", text, flags=re.MULTILINE)[0],
                           flags=re.MULTILINE))  # fmt: skip


def write_api() -> tuple[dict[str, list[str]], list[str]]:
    """Write the pages of public names; return their names, and names without an explanation."""
    names, problems = [], []
    for layer, meaning in layers().items():
        files = sorted((ROOT / "src" / layer).rglob("*.[fF]90"))
        modules = [one for path in files if (one := fortran.read_module(path.relative_to(ROOT)))]
        problems += [one for module in modules for one in fortran.unexplained(module)]
        names.append(f"fortran_{layer}")
        text = fortran.page(layer, meaning, modules)
        (SOURCE / f"fortran_{layer}.md").write_text(text, encoding="utf-8")
    (SOURCE / "python_names.md").write_text(PUBLIC, encoding="utf-8")
    return {"Python": ["python_names"], "Fortran": names}, problems


if __name__ == "__main__":
    sys.exit(main())
