"""Fixtures of several files of tests."""

from __future__ import annotations

import subprocess

import pytest
from support.program import ROOT


@pytest.fixture(scope="session")
def lacking(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Build the library of a file system that lacks something."""
    library = tmp_path_factory.mktemp("lacking") / "lacking.so"
    source = ROOT / "test/support/lacking.c"
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    return str(library)
