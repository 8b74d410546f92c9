"""Kind: reading files.
Wins if `stat` tells whether the grader has a certain file.
Defence: own uid and private root.
Control: wins without the sandbox.
"""

import os


def attack(target):
    return f"WON: {os.stat(target['public_file']).st_size} bytes"
