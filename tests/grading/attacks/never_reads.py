"""Kind: forging answers.
Wins if a full request pipe hangs the grader.
Defence: deadline per request, writing included.
Deadline: 0.5 s.
"""

import sys
import time


def attack(target):
    frame = sys._getframe()
    while "self" not in frame.f_locals or not hasattr(frame.f_locals["self"], "_operations"):
        frame = frame.f_back
    frame.f_locals["self"].serve = None
    print("asleep", flush=True)
    time.sleep(1e6)
