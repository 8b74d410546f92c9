"""Kind: resources.
Wins if more memory than allowed is used.
Defence: address space limit.
Deadline: 1 s.
"""


def attack(target):
    held = []
    while len(held) < 64:
        held.append(bytearray(64 << 20))
    return "WON"
