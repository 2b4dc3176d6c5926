"""Pictures: of the paper, of a run, of a moment."""

import os
import sys
from contextlib import suppress

# A Jupyter kernel gives its commands a backend that their Python need not have, with which
# matplotlib cannot be imported. Pictures are drawn by Agg; the user's own plots keep the backend.
if "matplotlib" not in sys.modules:
    backend = os.environ.pop("MPLBACKEND", None)
    import matplotlib as mpl

    if backend:
        os.environ["MPLBACKEND"] = backend
        with suppress(ValueError):
            mpl.rcParams["backend"] = backend
