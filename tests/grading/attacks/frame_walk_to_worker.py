"""Kind: searching memory.
Wins if the worker's own objects hold the future or the truth.
Defence: one frame at a time, the truth never enters.
"""

import sys


def attack(target):
    frame = sys._getframe()
    while "self" not in frame.f_locals or not hasattr(frame.f_locals["self"], "_operations"):
        frame = frame.f_back
    worker = frame.f_locals["self"]
    return [repr(vars(worker))[:4000], repr(frame.f_locals)[:4000], repr(sys.argv)]
