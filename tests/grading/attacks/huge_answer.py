"""Kind: hostile values.
Wins if an answer of hundreds of megabytes is taken in.
Defence: caps before allocation.
"""

import numpy as np


def attack(target):
    return np.zeros(30_000_000)
