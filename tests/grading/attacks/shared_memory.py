"""Kind: shared memory.
Wins if a POSIX shared memory object appears.
Defence: private root, Landlock, file size limit, seccomp.
"""

from multiprocessing import shared_memory


def attack(target):
    shared_memory.SharedMemory(target["token_name"], create=True, size=4096)
    return "WON"
