"""Kind: reading other processes.
Wins if /proc/PID/mem of the grader shows its memory.
Defence: own uid, private root, Landlock, no debugging.
Control: wins without the sandbox.
"""


def attack(target):
    with open(f"/proc/{target['parent']}/mem", "rb") as memory:
        memory.seek(target["address"])
        return memory.read(target["length"]).decode(errors="replace")
