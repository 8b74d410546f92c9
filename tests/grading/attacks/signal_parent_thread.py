"""Kind: signals.
Wins if a thread of the grader receives a signal.
Defence: own uid, seccomp, Landlock.
Control: wins without the sandbox.
"""

import ctypes
import signal


def attack(target):
    number = target["nr"]["tgkill"]
    done = ctypes.CDLL(None).syscall(number, target["parent"], target["parent"], signal.SIGUSR1)
    return "WON" if done == 0 else None
