"""Kind: forging answers.
Wins if shapes that do not fit the body make the grader allocate or crash.
Defence: shapes are checked against the body.
"""

import json
import os
import struct
import sys


def nonce():
    frame = sys._getframe()
    while "nonce" not in frame.f_locals or not isinstance(frame.f_locals["nonce"], str):
        frame = frame.f_back
    return frame.f_locals["nonce"]


def attack(target):
    shapes = [["<f8", [1 << 40, 1 << 40, 0, -1]], ["|O", [1]]]
    header = json.dumps({"nonce": nonce(), "ok": {"a": 0}, "arrays": shapes}).encode()
    os.write(target["pipes"][1], struct.pack("<4sIQ", b"SLC1", len(header), 8) + header + b"12345678")
    while True:
        pass
