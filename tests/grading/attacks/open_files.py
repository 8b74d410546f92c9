"""Kind: resources.
Wins if hundreds of files are open.
Defence: open file limit.
Control: wins without the sandbox.
"""

import os


def attack(target):
    for _ in range(500):
        os.pipe()
    return "WON"
