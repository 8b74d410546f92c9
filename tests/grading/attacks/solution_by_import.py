"""Kind: reading the solution.
Wins if the reference implementation can be imported.
Defence: only named modules of slamcmp are readable.
Control: wins without the sandbox.
"""


def attack(target):
    from slamcmp.backends.filters.ekf_slam import EkfSlam

    return f"WON: {EkfSlam}"
