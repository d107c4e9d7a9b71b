"""Keeping the format libraries from printing."""

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np


@contextmanager
def quiet_library(name: str) -> Iterator[None]:
    """Switch a library's logger and NumPy's warnings off.

    What the library would say of a file becomes an error of ours.
    """
    logger = logging.getLogger(name)
    before = logger.disabled
    logger.disabled = True
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        logger.disabled = before


@contextmanager
def quiet_stderr() -> Iterator[None]:
    """Send what C code writes to standard error nowhere, for the whole process."""
    try:
        kept = os.dup(2)
    except OSError:  # Standard error is closed: there is nothing to keep quiet.
        yield
        return
    try:
        with Path(os.devnull).open("wb") as sink:
            os.dup2(sink.fileno(), 2)
            yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
