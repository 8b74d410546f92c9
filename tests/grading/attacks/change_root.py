"""Kind: raising rights.
Wins if the root folder can be moved.
Defence: own uid, no new privileges, seccomp.
Control: wins without the sandbox.
"""

import os


def attack(target):
    os.chroot(os.path.dirname(__file__))
    return "WON"
