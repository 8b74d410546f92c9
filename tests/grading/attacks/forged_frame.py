"""Kind: forging answers.
Wins if a frame with an invented nonce is believed.
Defence: nonce per request, strict frames.
"""

import json
import os
import struct


def attack(target):
    header = json.dumps({"nonce": "0" * 32, "ok": "FORGED", "arrays": []}).encode()
    os.write(target["pipes"][1], struct.pack("<4sIQ", b"SLC1", len(header), 0) + header)
    return
