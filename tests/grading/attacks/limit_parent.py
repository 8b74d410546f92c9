"""Kind: signals.
Wins if the grader's resource limits are changed.
Defence: own uid, seccomp, Landlock.
Control: wins without the sandbox.
"""

import resource


def attack(target):
    soft, hard = resource.prlimit(target["victim"], resource.RLIMIT_NOFILE)
    resource.prlimit(target["victim"], resource.RLIMIT_NOFILE, (min(soft, 100), hard))
    return "WON"
