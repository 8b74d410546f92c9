"""Kind: signals.
Wins if the grader receives a signal.
Defence: own uid, seccomp, Landlock.
Control: wins without the sandbox.
"""

import os
import signal


def attack(target):
    os.kill(target["parent"], signal.SIGUSR1)
    return "WON"
