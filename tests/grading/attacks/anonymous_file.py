"""Kind: shared memory.
Wins if a file in memory is made, to be executed or passed on.
Defence: seccomp.
Control: wins without the sandbox.
"""

import os


def attack(target):
    os.memfd_create("x")
    return "WON"
