"""Kind: network.
Wins if the grader's machine accepts a connection.
Defence: seccomp, Landlock.
Control: wins without the sandbox.
"""

import socket


def attack(target):
    with socket.create_connection(("127.0.0.1", target["port"]), timeout=1) as connection:
        connection.sendall(b"x")
    return "WON"
