"""Kind: network.
Wins if io_uring, which passes filters by, can be set up.
Defence: seccomp.
Control: wins without the sandbox.
"""

import ctypes


def attack(target):
    parameters = ctypes.create_string_buffer(120)
    ring = ctypes.CDLL(None).syscall(target["nr"]["io_uring_setup"], 4, parameters)
    return "WON" if ring >= 0 else None
