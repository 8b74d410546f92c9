"""Kind: forging answers.
Wins if garbage on the reply pipe confuses the grader.
Defence: nonce per request, strict frames.
"""

import os


def attack(target):
    os.write(target["pipes"][1], b"{'score': 100}" * 100)
    return
