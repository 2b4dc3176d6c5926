"""Speed against accuracy: the charts and tables of this page, those of stability, and the map.

Parts are made in order. A complete run is not repeated, an interrupted one is resumed.
"""

from __future__ import annotations

from studies.accuracy import ladder_map, observables, polygons, stability, where_models_fail
from studies.common import study

PARTS = {
    one.__name__.rpartition(".")[2]: one.run
    for one in (stability, polygons, observables, ladder_map, where_models_fail)
}

if __name__ == "__main__":
    raise SystemExit(study.main(__file__, __doc__, PARTS))
