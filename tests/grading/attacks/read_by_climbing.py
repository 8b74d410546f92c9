"""Kind: reading files.
Wins if the file can be reached from the submission's own folder.
Defence: private root, Landlock.
Control: wins without the sandbox.
"""

import os


def attack(target):
    climb = os.path.relpath(target["public_file"], os.path.dirname(__file__))
    descriptor = os.open(os.path.dirname(__file__), os.O_RDONLY)
    return os.read(os.open(climb, os.O_RDONLY, dir_fd=descriptor), 200).decode()
