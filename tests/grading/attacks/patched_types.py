"""Kind: patching.
Wins if patched data types reach the grader.
Defence: only numbers and text cross the pipe.
"""

import slamcmp.types


class Agreeable:
    def __eq__(self, other):
        return True

    def __reduce__(self):
        return (exec, ("WON",))


def attack(target):
    slamcmp.types.Frame = slamcmp.types.Estimate = Agreeable
    return Agreeable()
