"""Kind: reading the solution.
Wins if the source of a solution is read from the installed package.
Defence: only named modules of slamcmp are readable.
Control: wins without the sandbox.
"""

import os

import slamcmp


def attack(target):
    path = os.path.join(os.path.dirname(slamcmp.__file__), "backends", "filters", "ekf_slam.py")
    return "WON" if "def " in open(path).read() else None
