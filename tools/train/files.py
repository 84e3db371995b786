"""Files that readers never see half of."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import numpy as np


@contextlib.contextmanager
def atomic(path: Path):
    """A binary file to write `path` with: beside it and renamed at the end, so that readers never see half of it. What is no
    regular file (a device, a pipe) is written as it is, and a link stays one. Errors: OSError."""
    if path.exists() and not path.is_file():
        with open(path, "wb") as file:
            yield file
        return
    path = path.resolve()
    temporary = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        with open(temporary, "wb") as file:
            yield file
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_atomically(path: Path, data: bytes) -> None:
    """Writes a whole file by `atomic`."""
    with atomic(path) as file:
        file.write(data)


def save_array(path: Path, array: np.ndarray) -> None:
    """Writes a .npy file."""
    with atomic(path) as file:
        np.save(file, array)
