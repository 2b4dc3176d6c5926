"""The seal of a results file: its last 512 bytes, with the digest of all bytes before them.

The program writes it (`src/store/checksum_footer.f90`). It is valid if it is exactly the text that
follows from the bytes before it. HDF5 ignores it, since it is behind the end of the HDF5 data; but
it cuts it off when a program opens the file for writing.
"""

from __future__ import annotations

import hashlib
import os
import re
import warnings
from typing import TYPE_CHECKING

from postproc.cli import InputError

if TYPE_CHECKING:
    from pathlib import Path
    from typing import BinaryIO

LENGTH = 512
FIRST_LINE = "battery results 1"
REMARK = "Before these 512 bytes is HDF5; head -c -512 FILE | sha256sum gives the digits above."
MARK = b"initial_file_fingerprint"  # in every file of the program, near its beginning
PIECE = 2**20  # bytes that are read at once
# Offsets of the length of the file in HDF5's superblock, by its version.
ENDS = (40, 44, 28, 28)


def seal_of(count: int, digits: str) -> bytes:
    """Return the seal of `count` bytes whose SHA-256 digest is `digits`, in hexadecimal."""
    text = f"{FIRST_LINE}\nbytes {count}\nsha256 {digits}\n{REMARK}\n"
    return f"{text:{LENGTH - 1}}\n".encode("ascii")


def check_seal(path: Path, *, verify: bool = False, quiet: bool = False) -> None:
    """Raise `InputError` unless a file ends with a seal for its length.

    A file that another program has opened for writing has lost its seal; it may still be whole, so
    there is only a warning. A digest that is left behind the HDF5 must be right.

    Parameters
    ----------
    path : the file.
    verify : whether to read the whole file, and require its digest. One whose seal is not as it was
        written is read whole in any case.
    quiet : whether to give no warning.
    """
    with path.open("rb") as file:  # once: it may be replaced by a longer one meanwhile
        size = os.fstat(file.fileno()).st_size
        first = file.read(PIECE)
        end = _end_in_hdf5(first)
        file.seek(max(size - LENGTH, 0))
        last, marked = file.read(), _has_mark(file, first)
        if in_place := size > LENGTH and last.startswith(FIRST_LINE.encode()):
            content = size - LENGTH
        else:  # it was cut off, in part or as a whole, or something is behind it
            content = end if marked and 0 < end <= size else size
        file.seek(content)
        digits = _digest_in(file.read(PIECE))
        whole = last == seal_of(size - LENGTH, digits)
        if digits and (verify or not whole) and digits != _digest(file, content):
            raise InputError(f"{path}: damaged: its digest is wrong")
    if whole:
        return
    known = marked and content == end
    if in_place and not (known and digits):
        raise InputError(f"{path}: damaged: its digest is wrong")
    if known and (digits or not verify):
        if quiet:
            return
        message = (
            f"{path}: was changed by another program, or is of a version before 0.2.0: it has no "
            "digest at its end; it is read as it is (battery --accept FILE.nml gives it a new one)"
        )
        warnings.warn(message, stacklevel=4)
    elif marked:
        reason = "cannot be verified" if known else "damaged"
        raise InputError(f"{path}: {reason}: it has no digest at its end")
    elif first.startswith(b"\x89HDF"):
        raise InputError(f"{path}: HDF5, but not written by battery, or only a piece of its file")
    else:
        raise InputError(f"{path}: not an HDF5 file")


def _has_mark(file: BinaryIO, first: bytes) -> bool:
    """Return whether a file is HDF5 and has the mark; programs that write it anew may move it."""
    if not first.startswith(b"\x89HDF") or MARK in first:
        return first.startswith(b"\x89HDF")
    file.seek(0)
    before = b""
    while piece := file.read(PIECE):
        if MARK in before + piece:
            return True
        before = piece[-len(MARK) :]
    return False


def _digest_in(behind: bytes) -> str:
    """Return the digest in what is left of a seal; "" if there is none."""
    found = re.search(rb"\nsha256 ([0-9a-f]{64})\n", behind)
    return found[1].decode() if found else ""


def _digest(file: BinaryIO, count: int) -> str:
    """Return the SHA-256 digest of the first bytes of a file, in hexadecimal."""
    digest = hashlib.sha256()
    file.seek(0)
    while count > 0 and (piece := file.read(min(count, PIECE))):
        digest.update(piece)
        count -= len(piece)
    return digest.hexdigest()


def _end_in_hdf5(first: bytes) -> int:
    """Return the length of a file according to HDF5's superblock; -1 if there is none."""
    version = first[8] if len(first) > max(ENDS) + 8 else len(ENDS)
    if version >= len(ENDS):
        return -1
    return int.from_bytes(first[ENDS[version] :][:8], "little")
