"""Kind: starting processes.
Wins if clone3, whose flags a filter cannot see, makes a process.
Defence: seccomp answers ENOSYS.
Control: wins without the sandbox.
"""

import ctypes
import os
import signal
import struct


def attack(target):
    arguments = struct.pack("=8Q", 0, 0, 0, 0, signal.SIGCHLD, 0, 0, 0)
    child = ctypes.CDLL(None).syscall(target["nr"]["clone3"], arguments, len(arguments))
    if child == 0:
        os._exit(0)
    return "WON" if child > 0 else None
