"""Kind: raising rights.
Wins if a system call newer than the filter's table is let through.
Defence: numbers above the table are answered ENOSYS.
Control: wins without the sandbox.
"""

import ctypes
import errno


def attack(target):
    libc = ctypes.CDLL(None, use_errno=True)
    libc.syscall(457, None, None, 0, 0)
    return None if ctypes.get_errno() == errno.ENOSYS else "WON"
