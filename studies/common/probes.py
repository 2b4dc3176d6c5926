"""Runs of the probe `accuracy-realNN`, the physics in one precision; answers are stored.

A question is a command line of the probe; its answer is JSON, one object per line, stored in
`folder/probes`. The probe runs again only if the question has changed. Numbers are read as
Decimals, with all their digits.
"""

from __future__ import annotations

import json
import subprocess
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from decimal import Decimal
from typing import TYPE_CHECKING, Any

from postproc.cli import InputError, ended_with_python, output_folder
from postproc.running import find_program

if TYPE_CHECKING:
    from collections.abc import Sequence

    from studies.common.study import Study

PRECISIONS = ("real32", "real64", "real128")
EPSILON = {"real32": 2.0**-24, "real64": 2.0**-53, "real128": 2.0**-113}  # half a unit of 1

Answer = list[dict[str, Any]]


@dataclass(frozen=True)
class Question:
    """One command of the probe.

    Attributes
    ----------
    name : the answer is stored as `probes/NAME.jsonl`.
    precision : real32, real64 or real128.
    words : the words after the program's name.
    patience : time limit in seconds.
    """

    name: str
    precision: str
    words: tuple[str, ...]
    patience: float = 600.0


def ask(study: Study, questions: Sequence[Question], *, exact: bool = True) -> list[Answer]:
    """Run the probe for all questions, on the ranks of the study; return the answers in order.

    exact : numbers with a point as Decimals, otherwise as floats.
    """
    output_folder(study.folder / "probes")
    with ThreadPoolExecutor(max(study.ranks, 1)) as pool:
        texts = list(pool.map(lambda one: _text(study, one), questions))
    number = Decimal if exact else float
    return [
        [json.loads(line, parse_float=number) for line in text.splitlines()[1:]] for text in texts
    ]


def _text(study: Study, question: Question) -> str:
    path = study.folder / "probes" / f"{question.name}.jsonl"
    head = json.dumps({"question": [question.precision, *question.words]})
    if path.exists() and not study.afresh:
        text = path.read_text(encoding="utf-8")
        if text.split("\n", 1)[0] == head:
            return text
    program = find_program(study.program).parent / f"accuracy-{question.precision}"
    if not program.exists():
        raise InputError(f"{program}: no such program (make probes)")
    try:
        done = subprocess.run(
            ended_with_python([program, *question.words]), cwd=study.folder, check=False, text=True,
            stdin=subprocess.DEVNULL, capture_output=True, timeout=question.patience,
        )  # fmt: skip
    except subprocess.TimeoutExpired as problem:
        message = f"{question.name}: no answer within {question.patience:g} s"
        raise InputError(message) from problem
    if done.returncode:
        lines = (done.stderr or done.stdout).strip().splitlines() or ["no output"]
        raise InputError(f"{question.name}: exit {done.returncode}: {lines[0]}")
    text = f"{head}\n{done.stdout}"
    part = path.with_suffix(".part")
    part.write_text(text, encoding="utf-8")
    part.rename(path)
    return text
