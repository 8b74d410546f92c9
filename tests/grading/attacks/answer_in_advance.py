"""Kind: forging answers.
Wins if the next request is answered before it is made.
Defence: the pipe must be empty before a request, nonce.
"""

import json
import os
import struct
import threading
import time


def late(pipe):
    time.sleep(0.05)
    header = json.dumps({"nonce": "0" * 32, "ok": "FORGED", "arrays": []}).encode()
    os.write(pipe, struct.pack("<4sIQ", b"SLC1", len(header), 0) + header)


def attack(target):
    threading.Thread(target=late, args=(target["pipes"][1],)).start()
    return
