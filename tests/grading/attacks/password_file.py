"""Kind: reading files.
Wins if the machine's password file is read.
Defence: own uid, private root, Landlock.
Control: wins without the sandbox.
"""


def attack(target):
    return "WON" if "root:" in open("/etc/shadow").read() + open("/etc/passwd").read() else None
