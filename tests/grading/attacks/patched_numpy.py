"""Kind: patching.
Wins if the grader's comparisons pass with a patched numpy.
Defence: the grader never imports the submission.
"""

import builtins

import numpy as np


def attack(target):
    np.allclose = lambda *a, **k: True
    np.linalg.norm = lambda *a, **k: 0.0
    builtins.abs = lambda value: 0
    return
