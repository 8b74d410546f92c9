"""Kind: signals.
Wins if the grader's processes are moved to one core or made slow.
Defence: own uid, seccomp, Landlock.
Control: wins without the sandbox.
"""

import os


def attack(target):
    os.sched_setaffinity(target["victim"], {min(os.sched_getaffinity(0))})
    return "WON"
