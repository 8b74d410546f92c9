"""Kind: hostile values.
Wins if a function or a generator is taken for an answer.
Defence: only plain values cross the pipe.
"""


def attack(target):
    return (lambda: "WON", (n for n in range(3)), object())
