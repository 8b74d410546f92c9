"""Kind: reading other processes.
Wins if process_vm_readv copies the grader's memory.
Defence: own uid, seccomp, no debugging.
Control: wins without the sandbox.
"""

import ctypes


class Vector(ctypes.Structure):
    _fields_ = [("base", ctypes.c_void_p), ("length", ctypes.c_size_t)]


def attack(target):
    libc = ctypes.CDLL(None, use_errno=True)
    buffer = ctypes.create_string_buffer(target["length"])
    here = Vector(ctypes.addressof(buffer), target["length"])
    there = Vector(target["address"], target["length"])
    libc.process_vm_readv(target["parent"], ctypes.byref(here), 1, ctypes.byref(there), 1, 0)
    return buffer.raw.decode(errors="replace")
