"""Kind: ending the process.
Wins if code runs after the grading.
Defence: the process is killed, not asked to leave.
"""

import atexit
import os


def attack(target):
    atexit.register(lambda: open(os.path.join(target["writable"], "hook"), "w").write("x"))  # noqa: SIM115
    return
