"""Kind: resources.
Wins if numpy gets more memory than allowed.
Defence: address space limit.
"""

import numpy as np


def attack(target):
    np.ones((20000, 20000))
    return "WON"
