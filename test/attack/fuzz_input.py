"""Mutants of namelists and initial files, each through `--check` of the built program.

Whatever the input, the program must say yes (exit 0) or what is wrong (exit 2) within seconds,
without a signal, without a backtrace, and must write nothing. Mutants that break this are kept.

    python test/attack/fuzz_input.py                     # 10,000 mutants, two at once
    python test/attack/fuzz_input.py 500 --seed 7 --jobs 1
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
from postproc import launcher  # noqa: E402

PROGRAM = Path(os.environ.get("BATTERY_PROGRAM", ROOT / "build/bin/battery"))
ENVIRONMENT = {
    **os.environ,
    **launcher.ALONE,
    "LC_ALL": "C.UTF-8",
}
# A mutant that asks for more than this is no fault of the reading; what it asks for is legal.
PATIENCE = 10.0

NAMELISTS = [
    "&particles number = 4 initial_file = 'start.txt' /\n&gate threshold = 1 /\n"
    "&run collisions = 1000 /\n&output file = 'out.h5' /\n",
    "! a scan\n&particles\n  number = 20, seed = 7, urn1_number = 12\n/\n"
    "&gate threshold_fraction = 0.1 /\n&table shape = 'circuit' urn_radius = 1.0\n"
    "  channel1_width = 3d-1, channel2_width = .5E-1 channel1_length = 1 /\n"
    "&run engine = \"collision\" duration = 2.5 transient_duration = 1 start_time = 0 /\n"
    "&scan channel2_width_range = 0.01, 0.2, 5 replicas = 2 /\n"
    "&output file = 'out.h5' series_interval = 0.5 snapshot_times = 0, 1 2.5 final_state = T /\n"
    "&limits wall_minutes = 3 checkpoint_minutes = 1 /\n",
    "&particles number = 9 /\n&scan threshold = 1, 2, 3 number = 5 6\n channel1_width=0.5 &end\n"
    "&run engine='timestep' time_step=1e-2 collisions=500 transient_collisions=0 /\n"
    "&table shape='urn' urn_radius=2*1 /\n&output event_log=.false. file='it''s.h5' /\n",
]
INITIAL = "# x y ux uy\n-1.4 0.1 1 0\n1.4, -0.2, 0.6d0, -8e-1\n\n-1.5\t0 0 1\r\n1.5 0 -1 .5\n"
PIECES = [
    "&", "/", "=", ",", ",,", "'", '"', "!", "#", "*", "3*", "0*", "999999999*1", "(1)", "%x",
    "-", "+", ".", "e", "d5", "1e", "1e400", "1e-400", "1d99999999999", "3-2", "1.5.5", "0x10",
    "&end", "NaN", "Infinity", "2147483647", "2147483648", "9223372036854775807", "-1", "0",
    "1e308", "T", ".true.", "\n", "\r", "\t", "\0", "\x1b[2J", "\xff", "\u00e9", " ", "number = 5",
    "&gate threshold = 1 /", "&run duration = 1 /", "&scan replicas = 2 /", "x" * 1100, "9" * 400,
]  # fmt: skip


NUMBER = re.compile(r"(?<![\w.])\d+(\.\d*)?")
NUMBERS = ["0", "1", "2", "3", "7", "0.1", "0.5", "1.5", "1e-3", "1e-12", "1e12", "100", "1e3"]


def other_numbers(text: str, dice: random.Random) -> str:
    """Change numbers only: what comes is often legal."""
    return NUMBER.sub(
        lambda found: dice.choice(NUMBERS) if dice.random() < 0.15 else found.group(), text
    )


def mutant_of(text: str, dice: random.Random) -> str:
    """Change a text in one to six places, or only its numbers."""
    if dice.random() < 0.4:
        return other_numbers(text, dice)
    for _ in range(dice.choice([1, 1, 1, 2, 3, 6])):
        at, end = sorted((dice.randint(0, len(text)), dice.randint(0, len(text))))
        end = min(end, at + dice.choice([1, 1, 4, 20, 200]))
        words = text.split(" ")
        match dice.randrange(7):
            case 0:
                text = text[:at] + text[end:]
            case 1:
                text = text[:at] + dice.choice(PIECES) + text[at:]
            case 2:
                text = text[:at] + dice.choice(PIECES) + text[end:]
            case 3:
                text = text[:end] + text[at:]
            case 4:
                text = text[:at] + chr(dice.randrange(256)) + text[at + 1 :]
            case 5:
                words[dice.randrange(len(words))] = dice.choice(PIECES)
                text = " ".join(words)
            case _:
                one, other = dice.randrange(len(words)), dice.randrange(len(words))
                words[one], words[other] = words[other], words[one]
                text = " ".join(words)
    return text


def files_of(seed: int) -> dict[str, bytes]:
    """Give the two input files of a seed: one of them, or both, changed."""
    dice = random.Random(seed)
    which = dice.choice(["namelist", "namelist", "initial", "both"])
    namelist = NAMELISTS[0] if which == "initial" else dice.choice(NAMELISTS)
    initial = INITIAL
    if which != "initial":
        namelist = mutant_of(namelist, dice)
    if which != "namelist":
        initial = mutant_of(initial, dice)
    return {
        "case.nml": namelist.encode("utf-8", "surrogateescape"),
        "start.txt": initial.encode("utf-8", "surrogateescape"),
    }


def fault_of(seed: int, folder: Path) -> tuple[str, int]:
    """Try one mutant in an empty folder; say what is wrong (nothing: empty), and the exit code."""
    files = files_of(seed)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    try:
        ended = subprocess.run(
            [str(PROGRAM), "--check", "case.nml"],
            cwd=folder,
            env=ENVIRONMENT,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=PATIENCE,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"no end within {PATIENCE:g} s", -1
    said = (ended.stdout + ended.stderr).decode(errors="replace")
    code = ended.returncode
    # A mutant of the time limit may stop the check itself.
    in_time = code != 3 or "stopped by &limits wall_minutes; nothing was written" in said
    if code not in {0, 2, 3} or not in_time:
        return f"exit code {code}: {said[-300:]}", code
    if "Backtrace" in said or "runtime error" in said:
        return f"a backtrace: {said[-300:]}", code
    if code == 2 and not ended.stderr.strip():
        return "refused without a word", code
    left = {path.name: path.read_bytes() for path in folder.iterdir()}
    if left != files:
        return f"something was written: {sorted(left)}", code
    return "", code


def attack(count: int, seed: int, jobs: int, keep: Path) -> tuple[Counter[int], dict[int, str]]:
    """Try so many mutants; give how often each exit code came, and the faults by seed."""
    codes: Counter[int] = Counter()
    faults: dict[int, str] = {}

    def one(number: int) -> tuple[int, str, int]:
        with tempfile.TemporaryDirectory(prefix="battery_fuzz_") as name:
            folder = Path(name)
            fault, code = fault_of(number, folder)
            if fault:
                shutil.copytree(folder, keep / str(number), dirs_exist_ok=True)
        return number, fault, code

    with ThreadPoolExecutor(jobs) as pool:
        for number, fault, code in pool.map(one, range(seed, seed + count)):
            codes[code] += 1
            if fault:
                faults[number] = fault
                print(f"seed {number}: {fault}", flush=True)
    return codes, faults


def main() -> int:
    """Attack, and say what came of it; give 1 if there are faults."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("count", nargs="?", type=int, default=10000, help="how many mutants")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first; the others follow")
    parser.add_argument("--jobs", type=int, default=2, help="how many at once")
    parser.add_argument(
        "--keep", type=Path, default=ROOT / "build/fuzz_input", help="folder for what fails"
    )
    arguments = parser.parse_args()
    arguments.keep.mkdir(parents=True, exist_ok=True)
    codes, faults = attack(arguments.count, arguments.seed, arguments.jobs, arguments.keep)
    counts = ", ".join(f"{number} times exit {code}" for code, number in sorted(codes.items()))
    print(f"{arguments.count} mutants: {counts}; {len(faults)} faults")
    if faults:
        print(f"kept in {arguments.keep}: {' '.join(map(str, sorted(faults)))}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
