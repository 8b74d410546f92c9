"""Kind: hostile values.
Wins if an exception whose text never ends or raises harms the worker's report.
Defence: every failure to describe is caught, deadline.
"""


class Evil(Exception):
    def __str__(self):
        raise Evil

    __repr__ = __str__


def attack(target):
    raise Evil
