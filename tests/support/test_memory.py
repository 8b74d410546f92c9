"""Memory that images took and gave back is there for the next one."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

FAULTS = """
import resource, sys
import numpy as np
from slamcmp.support.memory import keep_freed_memory

if sys.argv[1] == "kept":
    keep_freed_memory()
for round in range(41):
    if round == 1:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    # Largest first: what is freed last lies at the heap's end, which glibc would give back.
    arrays = [np.ones(megabytes * 131072) for megabytes in (12, 5, 3)]
    while arrays:
        arrays.pop(0)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(how: str, **environment: str) -> int:
    """Pages that forty rounds of taking and freeing 20 MB had to be given by the system."""
    own = {name: value for name, value in os.environ.items() if not name.startswith("MALLOC_")}
    command = [sys.executable, "-c", FAULTS, how]
    done = subprocess.run(command, env=own | environment, capture_output=True, text=True, check=True)
    return int(done.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the settings of glibc's allocator")
def test_freed_memory_is_kept_for_the_next_image_unless_the_user_says_otherwise() -> None:
    usual = faults("usual")
    assert faults("kept") < 0.05 * usual
    # A user's own threshold of 64 kB gives everything back, as before.
    assert faults("kept", MALLOC_TRIM_THRESHOLD_="65536", MALLOC_MMAP_THRESHOLD_="65536") > 0.5 * usual
