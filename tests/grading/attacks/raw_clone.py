"""Kind: starting processes.
Wins if clone by its number makes a process.
Defence: seccomp.
Control: wins without the sandbox.
"""

import ctypes
import os
import signal


def attack(target):
    child = ctypes.CDLL(None).syscall(target["nr"]["clone"], signal.SIGCHLD, 0, 0, 0, 0)
    if child == 0:
        os._exit(0)
    return "WON" if child > 0 else None
