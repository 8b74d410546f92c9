"""Kind: reading files.
Wins if a descriptor that the grader left open holds the secret.
Defence: descriptors are closed at start, own uid.
"""

import os


def attack(target):
    found = []
    for descriptor in range(3, 64):
        if descriptor not in target["pipes"]:
            try:
                found.append(os.pread(descriptor, 200, 0).decode(errors="replace"))
            except OSError:
                continue
    return found
