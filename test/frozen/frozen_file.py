"""Read and write the files of the frozen answers: sections of plain columns, one file a case."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parent
# Engines that see the same history; a fixed step has another, its own.
EXACT = ("excursion", "collision", "synchronous")
Columns = np.ndarray


@dataclass
class Answer:
    """What a run must give: its events, its end, how closely (times, then places), and whose."""

    # Columns kind, where, particle.
    events: Columns
    times: Columns
    # Columns x, y, ux, uy.
    final: Columns
    tolerance: float
    final_tolerance: float
    engines: tuple[str, ...] = ()


@dataclass
class Frozen:
    """A case: input, initial file, answers of the exact engines and of the fixed step."""

    namelist: str
    particles: str
    answers: dict[str, Answer]

    def input_of(self, engine: str) -> str:
        """Give the namelist for this engine."""
        return self.namelist.replace("'excursion'", f"'{engine}'")


def write_frozen(path: Path, about: str, frozen: Frozen, notes: dict[str, str]) -> None:
    """Write a case; notes say what each answer was checked against."""
    lines = [
        f"# {about}",
        "== namelist",
        frozen.namelist.rstrip(),
        "== particles",
        frozen.particles.rstrip(),
    ]
    for name, answer in frozen.answers.items():
        lines += [
            f"== {name}: events",
            f"# {notes[name]}",
            f"# engines {' '.join(answer.engines)}",
            f"# tolerance {answer.tolerance:.1e} {answer.final_tolerance:.1e}",
            "# kind where particle time",
        ]
        lines += [
            f"{kind} {where} {particle} {time:.15e}"
            for (kind, where, particle), time in zip(
                answer.events.tolist(), answer.times.tolist(), strict=True
            )
        ]
        lines += [f"== {name}: final", "# x y ux uy"]
        lines += [" ".join(f"{value:.15e}" for value in row) for row in answer.final.tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_frozen(path: Path) -> Frozen:
    """Read a case."""
    sections: dict[str, list[str]] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("== "):
            sections[line[3:]] = []
        elif sections:
            sections[list(sections)[-1]].append(line)
    answers = {}
    for title in [name for name in sections if name.endswith(": events")]:
        name = title.removesuffix(": events")
        said = {line.split()[1]: line.split()[2:] for line in sections[title] if line[0] == "#"}
        table = np.loadtxt(sections[title], ndmin=2)
        final = np.loadtxt(sections[f"{name}: final"], ndmin=2)
        answers[name] = Answer(
            table[:, :3].astype(int),
            table[:, 3],
            final,
            *map(float, said["tolerance"]),
            tuple(said["engines"]),
        )
    return Frozen(
        "\n".join(sections["namelist"]) + "\n", "\n".join(sections["particles"]) + "\n", answers
    )
