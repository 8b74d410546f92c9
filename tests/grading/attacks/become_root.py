"""Kind: raising rights.
Wins if the process is root (again).
Defence: own uid, no new privileges, seccomp.
Control: wins without the sandbox.
"""

import os


def attack(target):
    os.setresuid(0, 0, 0)
    return "WON" if os.geteuid() == 0 else None
