"""Kind: hostile values.
Wins if methods of a returned object run in the grader.
Defence: only plain values cross the pipe.
"""

import numpy as np


class Array(np.ndarray):
    def __array_finalize__(self, other):
        self.flags.writeable = True

    def __reduce__(self):
        return (exec, ("WON",))


class Text(str):
    def __str__(self):
        return "FORGED" * 10**6

    __repr__ = __eq__ = __hash__ = None


def attack(target):
    return [np.zeros(3).view(Array), Text("fine")]
