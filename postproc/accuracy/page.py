"""The page of the docs: a template, `page.md`, filled with the numbers that the parts have kept.

What the parts `OWN` found is written out in the template; what the others found, if they have been
made, by `sections`. A figure NAME.png of the study's folder is shown as ![what it
is](accuracy_NAME.png). Nothing is run here.
"""

from __future__ import annotations

import re
import shutil
import string
from pathlib import Path
from typing import TYPE_CHECKING

from postproc.accuracy.ladder import QUANTITIES, SCANNED
from postproc.accuracy.sections import SECTIONS
from postproc.cli import InputError, output_folder
from postproc.study.study import ROOT
from postproc.study.text import measured, number, percent, seconds, table, wrapped

if TYPE_CHECKING:
    from collections.abc import Callable

    from postproc.study.study import Study

TEMPLATE = Path(__file__).with_name("page.md")
NOT_RUN = "_This part has not been run._"
DOCS = ROOT / "docs"
APART = ("own_errors",)  # figures that no part makes: a command of their own, told on the page
OWN = ("observables", "gated_reversal", "pasts", "tail")
HEADS = {"chi": "chi, T = 7", "current": "net current, T = 7", "transition": "transition T"}


def _with_bias(one: dict) -> str:
    if one["value"] is None:
        return f"none from {SCANNED[0]} to {SCANNED[-1]}"
    if one["error"]:
        off = measured(100.0 * one["bias"], 100.0 * one["bias_error"])
        return f"{measured(one['value'], one['error'])} ({off} %)"
    return f"{number(one['value'], 4)} ({number(100.0 * one['bias'], 2)} %)"


def _ages(line: dict, name: str) -> dict[str, str]:
    """Return what runs lack of the current for want of age, and what is left of their bias."""
    one = line["current"]
    left = measured(100.0 * (one["bias"] + line["lack"]), 100.0 * one["bias_error"])
    return {f"{name}_lack": percent(line["lack"]), f"{name}_left": f"{left} %"}


def _shares(share: float, error: float | None) -> str:
    return f"{measured(100.0 * share, 100.0 * error)} %" if error else percent(share)


def fields_of_observables(numbers: dict) -> dict[str, str]:
    """Return the template's fields that chart two gives."""
    rows = {line["name"]: line for line in numbers["rows"]}
    truth = numbers["reference"]
    excursion, reservoir = rows["excursion"], rows["reservoir"]
    channels, eta = rows["renewal gate with channels"], rows["eta of the paper"]
    steps = [line for name, line in rows.items() if name.startswith("timestep")]
    seen = [line for line in steps if line["current"]["value"] is not None]
    finest = min(seen, key=lambda line: float(line["name"].split()[1]))
    head = ["rung", "CPU time", *(f"{HEADS[name]} (bias)" for name in QUANTITIES)]
    lines = [
        [line["name"], seconds(line["chi"]["seconds"]), *(_with_bias(line[q]) for q in QUANTITIES)]
        for line in numbers["rows"]
    ]
    def price(line: dict) -> float:
        return line["per_time"] / excursion["per_time"]

    averages = [
        [
            str(one["threshold"]), measured(one["chi"], one["error"]),
            measured(one["less"], one["less_error"]),
        ]
        for one in numbers["averages"]
    ]  # fmt: skip
    farthest = max(numbers["averages"], key=lambda one: abs(one["less"]))
    return {
        "averages": table(["T", "chi, average over time", "by collisions less that"], averages),
        "farthest": measured(farthest["less"], farthest["less_error"]),
        "farthest_at": str(farthest["threshold"]),
        "eta_current_bias": percent(abs(eta["current"]["bias"])),
        "eta_transition_bias": percent(abs(eta["transition"]["bias"])),
        "reference_chi": measured(truth["chi"]["value"], truth["chi"]["error"]),
        "reference_current": measured(truth["current"]["value"], truth["current"]["error"]),
        "own_current": measured(truth["own_current"]["value"], truth["own_current"]["error"]),
        **_ages(rows["collision"], "collision"),
        **_ages(rows["synchronous"], "synchronous"),
        "reference_transition": measured(
            truth["transition"]["value"], truth["transition"]["error"]
        ),
        "reference_time": number(numbers["reference_time"], 2),
        "rungs": table(head, lines),
        "eta_microseconds": number(1e6 * numbers["eta_seconds"], 2),
        "mean_field_ms": number(1e3 * eta["chi"]["seconds"], 2),
        "channels_chi_bias": percent(abs(channels["chi"]["bias"])),
        "eta_chi_bias": percent(abs(eta["chi"]["bias"])),
        "channels_chi": number(channels["chi"]["value"], 4),
        "channels_current": number(channels["current"]["value"], 4),
        "theory_current": number(channels["current"]["value"], 4),
        "reservoir_chi": measured(reservoir["chi"]["value"], reservoir["chi"]["error"]),
        "reservoir_current": measured(reservoir["current"]["value"], reservoir["current"]["error"]),
        "reservoir_current_bias": percent(abs(reservoir["current"]["bias"])),
        "reservoir_transition": number(reservoir["transition"]["value"], 4),
        "reservoir_ratio": percent(price(reservoir)),
        "step_current_bias": percent(abs(rows["timestep 0.01"]["current"]["bias"])),
        "finest_step": finest["name"].split()[1],
        "finest_current_bias": percent(abs(finest["current"]["bias"])),
        "finest_ratio": number(price(finest), 2),
        "collision_ratio": number(price(rows["collision"]), 2),
        "synchronous_ratio": number(price(rows["synchronous"]), 2),
    }


def _events(example: dict) -> str:
    """Return the events forth and back in the order of time, and where all ends."""
    turn = example["turn"]
    rows = [[number(time), text] for time, text in example["forth"]]
    rows.append([f"**{number(turn)}**", "**all velocities are turned**"])
    rows += [[number(turn + time), text] for time, text in example["back"]]
    return table(["t", "event"], rows)


def _pasts(one: dict, other: dict) -> str:
    """Return the events of two histories side by side."""
    times = sorted({round(time, 6) for past in (one, other) for time, _ in past["forth"]})
    rows = []
    for time in times:
        both = [
            ", ".join(text for at, text in past["forth"] if round(at, 6) == time)
            for past in (one, other)
        ]
        rows.append([number(time), *both])
    return table(["t", "one past", "the other"], rows)


def fields_of_gated_reversal(numbers: dict) -> dict[str, str]:
    """Return the template's fields that reversal with gates gives."""
    scan = [
        [
            str(one["number"]), str(one["threshold"]), number(one["threshold"] / one["number"], 2),
            number(one["per_time"], 2), measured(one["share"], one["error"]),
        ]
        for one in numbers["scan"]
    ]  # fmt: skip
    turned = [
        [
            str(one["number"]), str(one["threshold"]), str(one["reversals"]),
            _shares(one["undone"], one["undone_error"]), number(one["parting_median"], 2),
        ]
        for one in numbers["turned"]
    ]  # fmt: skip
    examples = numbers["examples"]
    head = ["N", "T", "reversals in the last 12", "undone", "histories part after (median)"]
    return {
        "turns": str(sum(one["turns"] for one in numbers["turned"])),
        "agreed": str(sum(one["parting_as_told"] for one in numbers["turned"])),
        "scan": table(["N", "T", "T/N", "reversals per unit time", "undone"], scan),
        "turned": table(head, turned),
        "turn": number(examples["undone"]["turn"], 2),
        "example_undone": _events(examples["undone"]),
        "example_not_undone": _events(examples["not_undone"]),
        "example_return": number(examples["undone"]["returns_within"], 1),
    }


def fields_of_pasts(numbers: dict) -> dict[str, str]:
    """Return the template's fields that the two pasts give."""
    one, other, near = numbers["past1"], numbers["past2"], numbers["nearby"]
    return {
        "tries": str(near["tries"]),
        "within": number(near["within"], 1),
        "nearby": number(near["differ_by"], 1),
        "by_hand": number(near["by_hand_differ_by"], 1),
        "pasts": _pasts(one, other),
        "past_turn": number(one["turn"], 2),
        "present": ", ".join(number(row[0], 2) for row in one["forth_end"]),
        "two_pasts": number(numbers["differ_by"], 1),
        "volume1": f"{numbers['volume_ratios'][0]:.6f}",
        "volume2": f"{numbers['volume_ratios'][1]:.6f}",
    }


def fields_of_tail(numbers: dict) -> dict[str, str]:
    """Return the template's fields that the tail of currents gives."""
    many, split = numbers["ensemble"], numbers["split"]
    per_time = many["collisions_per_time"]
    excess = split["down"]["mean"] - split["down_expected"]
    more = split["down_rest"]["mean"] - split["down_expected"]
    lengths = {name: many[f"{name}_time"] for name in ("typical", "deviation")}
    lengths["rest"] = split["rest_time"]
    return {
        "runs": str(many["replicas"]),
        "run_time": number(many["duration"], 2),
        "run_collisions": number(many["duration"] * per_time, 2),
        "longest_run": number(many["duration"], 2),
        "log_time": number(split["duration"], 2),
        "logs": str(split["logs"]),
        "least": number(min(many["currents"]), 4),
        "greatest": number(max(many["currents"]), 4),
        "mean": measured(many["mean"], many["error"]),
        "straight": measured(split["straight"]["mean"], split["straight"]["error"]),
        "total": measured(split["total"]["mean"], split["total"]["error"]),
        "rest": measured(split["rest"]["mean"], split["rest"]["error"]),
        "zigzag_share": percent(split["on_zigzag"]),
        "axis_share": percent(split["on_axis"]),
        "zigzag_slope": number(split["zigzag_slope"], 4),
        "slope_low": number(split["slopes"][0], 4),
        "slope_high": number(split["slopes"][2], 4),
        "urn2": number(split["urn2_number"], 4),
        "down": measured(split["down"]["mean"], split["down"]["error"]),
        "down_expected": number(split["down_expected"], 4),
        "down_more": number(more, 2),
        "explained": percent(1.0 - more / excess),
        "up": number(split["up"]["mean"], 3),
        "up_expected": number(split["up_expected"], 3),
        "urn1": number(split["urn1_number"], 3),
        "fed": str(split["fed_by_gate"]),
        "fed_of": str(split["fed_of"]),
        "law_scale": number(split["law"]["scale"], 2),
        "law_exponent": number(split["law"]["exponent"], 2),
        "longest": str(split["longest"]),
        "longest_time": number(split["longest"] * split["round_time"], 2),
        "turned_gate1": str(split["turned_gate1"]),
        "entries_gate1": number(split["entries_gate1"], 2),
        "paper_time": number(many["paper_time"], 2),
        "paper_deviation": percent(many["paper_deviation"] / many["mean"]),
        "paper_half_width": percent(many["paper_half_width"] / many["mean"]),
        **{f"{name}_time": number(value, 2) for name, value in lengths.items()},
        **{
            f"{name}_collisions": number(None if value is None else value * per_time, 2)
            for name, value in lengths.items()
        },
    }


FIELDS: dict[str, Callable[[dict], dict[str, str]]] = {
    "observables": fields_of_observables,
    "gated_reversal": fields_of_gated_reversal,
    "pasts": fields_of_pasts,
    "tail": fields_of_tail,
}


def names_of(template: str) -> set[str]:
    """Return the names of the fields of a template."""
    return {name for _, name, _, _ in string.Formatter().parse(template) if name}


def page(study: Study) -> str:
    """Return the page; every part of this file's own must have been made."""
    fields = {"kind": "full" if study.full else "quick"}
    for part in OWN:
        numbers = study.kept(part)
        if numbers is None:
            raise InputError(f"{study.folder}: part {part} has not been made")
        fields |= FIELDS[part](numbers)
    for part, show in SECTIONS.items():
        numbers = study.kept(part)
        fields[part] = NOT_RUN if numbers is None else show(numbers)
    template = TEMPLATE.read_text(encoding="utf-8")
    lacking = names_of(template) - fields.keys()
    if lacking:
        raise InputError(f"{TEMPLATE.name}: nothing to fill {sorted(lacking)[0]} with")
    return wrapped(template.format(**fields))


def figures_of(text: str) -> list[str]:
    """Return the names of the figures that a page shows: NAME for accuracy_NAME.png."""
    return re.findall(r"\]\(accuracy_(\w+)\.png\)", text)


def publish(text: str, source: Path, folder: Path) -> Path:
    """Write the page and its figures, NAME.png of `source` as accuracy_NAME.png, into a folder."""
    path = output_folder(folder) / "accuracy.md"
    for name in figures_of(text):
        shown = folder / f"accuracy_{name}.png"
        figure = DOCS / shown.name if name in APART else source / f"{name}.png"
        if not figure.exists():
            raise InputError(f"{figure}: no such figure")
        if figure.resolve() != shown.resolve():
            shutil.copyfile(figure, shown)
    path.write_text(text, encoding="utf-8")
    print(path)
    return path


def run(study: Study) -> None:
    """Write the page into the study's folder, and into the docs if that is asked for."""
    text = page(study)
    publish(text, study.folder, study.folder)
    if study.page is not None:
        publish(text, study.folder, DOCS)
