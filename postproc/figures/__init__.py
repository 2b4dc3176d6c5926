"""Pictures: of the paper, of a run, of a moment."""

import os
import sys
from contextlib import suppress

from postproc.cli import InputError

# A Jupyter kernel gives its commands a backend that their Python need not have, with which
# matplotlib cannot be imported. Pictures are drawn by Agg; the user's own plots keep the backend.
if "matplotlib" not in sys.modules:
    backend = os.environ.pop("MPLBACKEND", None)
    try:
        import matplotlib as mpl
        import matplotlib.style
    except ImportError:
        raise
    except Exception as problem:  # a file of settings that cannot be read, an unknown locale
        raise InputError(
            "matplotlib cannot be imported with the settings of this user (matplotlibrc, "
            f"stylelib): {problem}"
        ) from problem
    finally:
        if backend:
            os.environ["MPLBACKEND"] = backend
    if backend:
        with suppress(ValueError):
            mpl.rcParams["backend"] = backend
