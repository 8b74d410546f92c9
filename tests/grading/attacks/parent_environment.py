"""Kind: reading other processes.
Wins if the secret is found in the environment of a grading process.
Defence: own uid, private root, Landlock, no debugging.
Control: wins without the sandbox.
"""


def attack(target):
    return open(f"/proc/{target['victim']}/environ").read()
