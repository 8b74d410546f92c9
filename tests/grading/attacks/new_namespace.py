"""Kind: raising rights.
Wins if a namespace with all rights inside is made.
Defence: own uid, no new privileges, seccomp.
Control: wins without the sandbox.
"""

import ctypes


def attack(target):
    return "WON" if ctypes.CDLL(None).unshare(0x10000000 | 0x20000) == 0 else None
