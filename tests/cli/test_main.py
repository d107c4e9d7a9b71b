"""The command begins again, in its process, with what glibc reads only at the beginning."""

import os
import subprocess
import sys

import pytest

TELLS = """
import os, sys
begun = os.environ.setdefault("BEGUN", str(os.getpid()))
import nolens.__main__
print(begun == str(os.getpid()), os.environ["GLIBC_TUNABLES"], *sys.argv[1:])
"""


def has_glibc() -> bool:
    try:
        return sys.platform == "linux" and bool(os.confstr("CS_GNU_LIBC_VERSION"))
    except ValueError:
        return False


@pytest.mark.skipif(not has_glibc(), reason="not glibc, or not Linux")
@pytest.mark.parametrize(
    ("own", "expected"),
    [
        (None, "glibc.malloc.tcache_count=0"),
        ("glibc.malloc.perturb=0", "glibc.malloc.perturb=0:glibc.malloc.tcache_count=0"),
        ("glibc.malloc.tcache_count=7", "glibc.malloc.tcache_count=7"),
    ],
)
def test_small_pieces_of_memory_are_not_kept(own: str | None, expected: str) -> None:
    variables = {key: each for key, each in os.environ.items() if key != "GLIBC_TUNABLES"}
    variables |= {} if own is None else {"GLIBC_TUNABLES": own}
    arguments = [sys.executable, "-c", TELLS, "a b", "--c"]
    done = subprocess.run(arguments, env=variables, capture_output=True, text=True, check=True)
    assert done.stdout == f"True {expected} a b --c\n"
