"""Kind: reading files.
Wins if the content of a file that every user may read comes back.
Defence: private root, Landlock.
Control: wins without the sandbox.
"""

from pathlib import Path


def attack(target):
    return Path(target["public_file"]).read_text()
