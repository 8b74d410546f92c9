"""Kind: forging answers.
Wins if the grader parses a header of any length.
Defence: caps before allocation.
"""

import os
import struct


def attack(target):
    os.write(target["pipes"][1], struct.pack("<4sIQ", b"SLC1", (1 << 32) - 1, 0))
    while True:
        pass
