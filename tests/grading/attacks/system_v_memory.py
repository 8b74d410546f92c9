"""Kind: shared memory.
Wins if a System V segment is made.
Defence: seccomp, own IPC namespace.
Control: wins without the sandbox.
"""

import ctypes


def attack(target):
    segment = ctypes.CDLL(None).shmget(0, 4096, 0o1600)
    if segment < 0:
        return None
    ctypes.CDLL(None).shmctl(segment, 0, None)
    return "WON"
