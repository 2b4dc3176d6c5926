"""The seal of a results file: every bit of it counts."""

from __future__ import annotations

import hashlib
import random
from typing import TYPE_CHECKING

import pytest

from postproc.cli import InputError
from postproc.reading import seal

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Give a sealed file of more than one piece."""
    content = random.Random(8).randbytes(seal.PIECE + 1000) + seal.MARK
    path = tmp_path / "run.h5"
    path.write_bytes(content + seal.seal_of(len(content), hashlib.sha256(content).hexdigest()))
    return path


def _flipped(path: Path, bits: list[int]) -> int:
    whole = bytearray(path.read_bytes())
    noticed = 0
    for bit in bits:
        whole[bit // 8] ^= 1 << bit % 8
        path.write_bytes(whole)
        whole[bit // 8] ^= 1 << bit % 8
        with pytest.raises(InputError, match="damaged: "):
            seal.check_seal(path, verify=True)
        noticed += 1
    return noticed


def test_a_whole_file_is_right(path: Path) -> None:
    seal.check_seal(path)
    seal.check_seal(path, verify=True)


def test_every_byte_of_the_seal_counts(path: Path) -> None:
    size = path.stat().st_size
    choose = random.Random(1).randrange
    bits = [8 * byte + choose(8) for byte in range(size - seal.LENGTH, size)]
    assert _flipped(path, bits) == seal.LENGTH


def test_every_byte_before_it_counts(path: Path) -> None:
    size = path.stat().st_size
    choose = random.Random(2).randrange
    bits = [0, 8 * (size - seal.LENGTH) - 1, *(choose(8 * size) for _ in range(100))]
    assert _flipped(path, bits) == len(bits)


@pytest.mark.parametrize("size", [0, 1, 511, 512, 513, -1, -seal.LENGTH])
def test_a_piece_of_a_file_is_not_the_file(path: Path, size: int) -> None:
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(InputError, match=path.name):
        seal.check_seal(path)
