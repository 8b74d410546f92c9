"""Kind: raising rights.
Wins if a file system can be mounted.
Defence: own uid, no new privileges, seccomp.
Control: wins without the sandbox.
"""

import ctypes


def attack(target):
    done = ctypes.CDLL(None).mount(b"tmpfs", target["writable"].encode(), b"tmpfs", 0, None)
    if done == 0:
        ctypes.CDLL(None).umount2(target["writable"].encode(), 2)
    return "WON" if done == 0 else None
