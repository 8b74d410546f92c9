"""Kind: network.
Wins if the system call by its number makes a socket.
Defence: seccomp, Landlock.
Control: wins without the sandbox.
"""

import ctypes


def attack(target):
    descriptor = ctypes.CDLL(None).syscall(target["nr"]["socket"], 2, 1, 0)
    return "WON" if descriptor >= 0 else None
