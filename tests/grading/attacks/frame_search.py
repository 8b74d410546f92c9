"""Kind: searching memory.
Wins if a frame, module or object of this process holds the truth.
Defence: the truth never enters this process.
"""

import gc
import sys


def attack(target):
    found, frame = [], sys._getframe()
    while frame is not None:
        found += [repr(value)[:300] for value in frame.f_locals.values()]
        frame = frame.f_back
    for thing in gc.get_objects():
        if isinstance(thing, dict) and ("truth" in thing or "secret" in thing):
            found.append(repr(thing)[:300])
    return found[:2000]
