"""Kind: reading files.
Wins if the content of a file comes back.
Defence: private root, Landlock.
Control: wins without the sandbox.
"""

import numpy as np


def attack(target):
    return np.fromfile(target["public_file"], dtype=np.uint8)
