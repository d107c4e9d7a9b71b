"""The command begins again, in its process, with what glibc reads only at the beginning."""

import os
import sys
from pathlib import Path

import pytest
from running import command

from nolens import __version__

AT_EVERY_START = """
import os, sys
print(os.getpid(), os.environ.get("GLIBC_TUNABLES"), file=sys.stderr)
"""
OURS = "glibc.malloc.tcache_count=0"


def has_glibc() -> bool:
    try:
        return sys.platform == "linux" and bool(os.confstr("CS_GNU_LIBC_VERSION"))
    except ValueError:
        return False


@pytest.mark.skipif(not has_glibc(), reason="not glibc, or not Linux")
@pytest.mark.parametrize(
    ("own", "starts"),
    [
        (None, ["None", OURS]),
        ("glibc.malloc.perturb=0", ["glibc.malloc.perturb=0", f"glibc.malloc.perturb=0:{OURS}"]),
        ("glibc.malloc.tcache_count=7", ["glibc.malloc.tcache_count=7"]),
    ],
)
def test_small_pieces_of_memory_are_not_kept(
    own: str | None, starts: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sitecustomize.py").write_text(AT_EVERY_START)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.delenv("GLIBC_TUNABLES", raising=False)
    if own is not None:
        monkeypatch.setenv("GLIBC_TUNABLES", own)
    done = command("--version")
    assert (done.code, done.out) == (0, f"{__version__}\n")
    processes, tunables = zip(*(line.split(" ") for line in done.err.splitlines()), strict=True)
    assert list(tunables) == starts
    assert len(set(processes)) == 1
