"""Kind: reading files.
Wins if the names in a folder of the grader come back.
Defence: private root, Landlock.
Control: wins without the sandbox.
"""

import os


def attack(target):
    folder = os.path.dirname(target["public_file"])
    return "WON" if os.listdir(folder) else None
