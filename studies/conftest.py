"""What tests of several studies share."""

from __future__ import annotations

import io
import subprocess
from contextlib import redirect_stdout
from types import SimpleNamespace
from typing import TYPE_CHECKING

import pytest

from postproc.commands import theory
from studies.common import study

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence


@pytest.fixture(scope="module")
def theory_in_process() -> Iterator[None]:
    """Let `Study.theory` call its command in this process: another one takes 1.3 s to start.

    The options and the JSON are those of the command line. That it starts a process is left to
    studies/common/test_circulations.py.
    """

    def run(command: Sequence[str], **_: object) -> subprocess.CompletedProcess[str]:
        words = list(command[command.index("postproc.theory") + 1 :])
        with redirect_stdout(io.StringIO()) as printed:
            code = theory.main(words)
        return subprocess.CompletedProcess(command, code, printed.getvalue(), "")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "subprocess", SimpleNamespace(run=run))
        yield
