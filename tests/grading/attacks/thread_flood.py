"""Kind: resources.
Wins if hundreds of threads run.
Defence: thread limit of the own uid, address space limit.
"""

import threading
import time


def attack(target):
    for _ in range(500):
        threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
    return "WON"
