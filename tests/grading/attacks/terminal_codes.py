"""Kind: hostile values.
Wins if control characters reach the teacher's terminal.
Defence: control characters are replaced.
"""


def attack(target):
    raise ValueError("\x1b[2J\x1b]0;title\x07 all tests passed\r" * 3)
