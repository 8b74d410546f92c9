"""Kind: patching.
Wins if a patched clock makes the submission look fast.
Defence: processor time is read from the kernel by the grader.
"""

import time


def attack(target):
    time.perf_counter = time.monotonic = time.time = time.process_time = lambda: 0.0
    return
