"""Kind: forging answers.
Wins if a patched protocol module answers every later request with a pass.
Defence: scores are computed by the grader from the numbers themselves.
"""

import slamcmp.grading.sandbox.pipes.protocol as protocol

genuine = protocol.encode


def attack(target):
    def forged(message):
        message.pop("error", None)
        message["ok"] = "FORGED"
        message["score"] = 100
        return genuine(message)

    protocol.encode = forged
    return
