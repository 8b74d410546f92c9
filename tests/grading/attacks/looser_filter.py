"""Kind: raising rights.
Wins if the filter or its marks can be taken off.
Defence: a filter can only be added to.
Control: wins without the sandbox.
"""

import ctypes


def attack(target):
    libc = ctypes.CDLL(None)
    dumpable = libc.prctl(4, 1, 0, 0, 0)
    seccomp = libc.prctl(22, 0, 0, 0, 0)
    privileges = libc.prctl(38, 0, 0, 0, 0)
    orphan = libc.prctl(1, 0, 0, 0, 0)
    return "WON" if 0 in (dumpable, seccomp, privileges, orphan) else None
