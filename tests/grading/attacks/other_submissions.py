"""Kind: reading files.
Wins if files of another submission being graded are found.
Defence: private root, Landlock.
Control: wins without the sandbox.
"""

import glob


def attack(target):
    return [open(path).read() for path in glob.glob(target["other_submission"])]
