"""Makes the speed-accuracy charts and tables of the ladder of models, and those of stability.

Parts are made in order; a complete run is not repeated, an interrupted one is resumed.
"""

from __future__ import annotations

import importlib
import time

from postproc import cli
from postproc.figures import style
from postproc.study import Study, add_options, chosen_parts, study_of
from postproc.study.study import NAMELISTS, ROOT

PARTS = ("stability", "polygons", "observables", "ladder_map")  # modules here with run(study)


@style.settings()
def make(part: str, study: Study) -> None:
    """Make one part, and print how long it took."""
    began = time.monotonic()
    importlib.import_module(f"postproc.accuracy.{part}").run(study)
    print(f"{part}: {time.monotonic() - began:.0f} s", flush=True)


def main(arguments: list[str] | None = None) -> int:
    """Make all parts, or the named ones."""
    options = cli.parser("accuracy", __doc__)
    add_options(options, ROOT / "build/accuracy", PARTS)
    given = options.parse_args(arguments)
    study = study_of(given, NAMELISTS, (ROOT / "docs", "accuracy_"))
    for part in chosen_parts(given, PARTS):
        make(part, study)
    return 0


if __name__ == "__main__":
    raise SystemExit(cli.run(main))
