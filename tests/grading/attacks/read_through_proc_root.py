"""Kind: reading files.
Wins if /proc/PID/root of the grader leads to the file.
Defence: private root, Landlock, no debugging.
Control: wins without the sandbox.
"""


def attack(target):
    with open(f"/proc/{target['parent']}/root{target['public_file']}") as file:
        return file.read()
