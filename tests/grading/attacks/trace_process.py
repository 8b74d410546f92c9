"""Kind: reading other processes.
Wins if ptrace attaches to a process of the grader.
Defence: own uid, seccomp.
Control: wins without the sandbox.
"""

import ctypes


def attack(target):
    libc = ctypes.CDLL(None, use_errno=True)
    seized = libc.ptrace(0x4206, target["victim"], 0, 0)
    return "WON" if seized == 0 else None
