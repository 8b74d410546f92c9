"""Kind: reading other processes.
Wins if the grader's command line is read.
Defence: private root, Landlock.
Control: wins without the sandbox.
"""


def attack(target):
    return "WON" if open(f"/proc/{target['parent']}/cmdline").read() else None
