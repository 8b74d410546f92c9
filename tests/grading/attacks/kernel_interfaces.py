"""Kind: raising rights.
Wins if bpf, perf events, key rings or page fault handling can be used.
Defence: seccomp.
Control: wins without the sandbox.
"""

import ctypes


def attack(target):
    libc, nr = ctypes.CDLL(None), target["nr"]
    room = ctypes.create_string_buffer(128)
    tries = (
        libc.syscall(nr["userfaultfd"], 0),
        libc.syscall(nr["keyctl"], 0, -3, 1),
        libc.syscall(nr["bpf"], 0, room, 0x7FFF0000),
        libc.syscall(nr["add_key"], b"user", b"x", b"x", 1, -3),
    )
    return "WON" if max(tries) >= 0 else None
