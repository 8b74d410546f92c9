"""Kind: resources.
Wins if ignoring every signal keeps the process alive.
Defence: deadline per request, kill -9 of the group.
Deadline: 0.5 s.
"""

import signal


def attack(target):
    for number in set(signal.Signals) - {signal.SIGKILL, signal.SIGSTOP}:
        signal.signal(number, signal.SIG_IGN)
    while True:
        pass
