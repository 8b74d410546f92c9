"""Kind: reading the solution.
Wins if the registry hands out the reference implementation.
Defence: only named modules of slamcmp are readable.
Control: wins without the sandbox.
"""


def attack(target):
    from slamcmp.registry import back_ends

    return f"WON: {back_ends.get('ekf_slam')}"
