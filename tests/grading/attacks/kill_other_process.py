"""Kind: signals.
Wins if another process of the grader's user dies.
Defence: own uid, seccomp, Landlock.
Control: wins without the sandbox.
"""

import os
import signal


def attack(target):
    os.kill(target["victim"], signal.SIGKILL)
    return "WON"
