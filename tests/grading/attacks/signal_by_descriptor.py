"""Kind: signals.
Wins if a process descriptor carries a signal to the grader.
Defence: own uid, seccomp, Landlock.
Control: wins without the sandbox.
"""

import ctypes
import signal


def attack(target):
    libc = ctypes.CDLL(None)
    process = libc.syscall(target["nr"]["pidfd_open"], target["parent"], 0)
    done = libc.syscall(target["nr"]["pidfd_send_signal"], process, signal.SIGUSR1, None, 0)
    return "WON" if done == 0 else None
