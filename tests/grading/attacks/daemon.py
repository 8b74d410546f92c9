"""Kind: starting processes.
Wins if a process outlives the grading.
Defence: seccomp.
"""

import os
import time


def attack(target):
    if os.fork() == 0:
        os.setsid()
        if os.fork() == 0:
            time.sleep(30)
        os._exit(0)
    return "WON"
