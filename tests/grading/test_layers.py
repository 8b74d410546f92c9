"""Each layer on its own: the filter's program is run here, instruction by instruction, for both machines."""

from __future__ import annotations

import errno
import os
import platform
import re
import struct
import sys
from pathlib import Path

import pytest

from slamcmp.grading.sandbox.walls import identity, layers, readable
from slamcmp.grading.sandbox.walls.landlock import landlock_abi
from slamcmp.grading.sandbox.walls.proofs import MEANING, judge, level_of
from slamcmp.grading.sandbox.walls.seccomp import AUDIT_ARCH, Instruction, program
from slamcmp.grading.sandbox.walls.syscalls import DENIED, FILTERED, NEWEST_KNOWN, number

MACHINES = ("x86_64", "aarch64")
PID = 4242
ALLOW, KILL = 0x7FFF0000, 0x80000000
EPERM, ENOSYS = 0x50000 | errno.EPERM, 0x50000 | errno.ENOSYS
# read, write, mmap, munmap, futex, exit_group, getrandom, openat, rt_sigaction
HARMLESS = {
    "x86_64": (0, 1, 9, 11, 202, 231, 318, 257, 13),
    "aarch64": (63, 64, 222, 215, 98, 94, 278, 56, 134),
}


def run(lines: list[Instruction], data: bytes) -> int:
    """Classic BPF as the kernel runs it, the four instructions that occur."""
    at, word = 0, 0
    while True:
        code, if_true, if_false, constant = lines[at]
        at += 1
        if code == 0x20:
            (word,) = struct.unpack_from("<I", data, constant)
        elif code == 0x06:
            return constant
        else:
            holds = {0x15: word == constant, 0x25: word > constant, 0x45: bool(word & constant)}[code]
            at += if_true if holds else if_false


def verdict(
    machine: str, call: int, *arguments: int, arch: int | None = None, open_to_write: bool = True
) -> int:
    padded = [value & (1 << 64) - 1 for value in (*arguments, 0, 0, 0, 0, 0, 0)][:6]
    data = struct.pack("<iIQ6Q", call, AUDIT_ARCH[machine] if arch is None else arch, 0, *padded)
    return run(program(machine, PID, open_to_write=open_to_write), data)


def of(machine: str, name: str) -> int:
    value = number(name, machine)
    assert value is not None
    return value


@pytest.mark.parametrize("machine", MACHINES)
def test_every_listed_call_is_denied_and_harmless_ones_pass(machine: str) -> None:
    denied = [value for name in DENIED if (value := number(name, machine)) is not None]
    assert len(denied) > 100
    assert {verdict(machine, value) for value in denied} == {EPERM}
    assert {verdict(machine, value) for value in HARMLESS[machine]} == {ALLOW}


@pytest.mark.parametrize("machine", MACHINES)
def test_calls_are_filtered_by_their_arguments(machine: str) -> None:
    def judged(name: str, *arguments: int) -> int:
        return verdict(machine, of(machine, name), *arguments)

    thread, process = 0x3D0F00, 17
    assert judged("clone", thread) == ALLOW
    assert judged("clone", process) == EPERM
    assert judged("clone", 0x4111) == EPERM  # vfork
    assert judged("clone3") == ENOSYS
    for name in ("kill", "tgkill", "rt_sigqueueinfo", "rt_tgsigqueueinfo"):
        assert judged(name, PID) == ALLOW
        # The kernel takes the lower half: a number that differs above it is the same process.
        assert judged(name, PID + (1 << 32)) == ALLOW
        assert {judged(name, pid) for pid in (0, 1, -1, -PID, PID + 1)} == {EPERM}
    for name in ("prlimit64", "sched_setaffinity"):
        assert {judged(name, pid) for pid in (0, PID)} == {ALLOW}
        assert {judged(name, pid) for pid in (1, PID - 1)} == {EPERM}
    assert judged("prctl", 15) == ALLOW
    assert {judged("prctl", option) for option in (1, 4, 22, 8, 24, 47, 59)} == {EPERM}
    assert judged("fcntl", 3, 1) == ALLOW
    assert {judged("fcntl", 3, command) for command in (8, 10, 15)} == {EPERM}
    assert judged("ioctl", 1, 0x5401) == ALLOW
    assert judged("ioctl", 1, 0x5412) == EPERM


@pytest.mark.parametrize("machine", MACHINES)
def test_opening_to_write_is_denied_where_nothing_else_protects_files(machine: str) -> None:
    reading = os.O_RDONLY | os.O_CLOEXEC
    changing = (os.O_WRONLY, os.O_RDWR, os.O_CREAT, os.O_TRUNC, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    calls = [(name, at) for name, at in (("open", 1), ("openat", 2)) if number(name, machine) is not None]
    for name, at in calls:
        before = [0] * at
        assert verdict(machine, of(machine, name), *before, reading, open_to_write=False) == ALLOW
        for flags in changing:
            assert verdict(machine, of(machine, name), *before, flags, open_to_write=False) == EPERM
            assert verdict(machine, of(machine, name), *before, flags) == ALLOW
    assert verdict(machine, of(machine, "openat2"), open_to_write=False) == ENOSYS


@pytest.mark.parametrize("machine", MACHINES)
def test_foreign_and_future_numbers_do_not_pass(machine: str) -> None:
    other = next(arch for name, arch in AUDIT_ARCH.items() if name != machine)
    assert verdict(machine, HARMLESS[machine][0], arch=other) == KILL
    # 32-bit programs on the same processor.
    assert verdict(machine, HARMLESS[machine][0], arch=0x40000003) == KILL
    assert verdict(machine, NEWEST_KNOWN + 1) == ENOSYS
    if machine == "x86_64":
        assert verdict(machine, 0x40000000) == KILL


@pytest.mark.skipif(platform.system() != "Linux", reason="compares with Linux headers")
@pytest.mark.parametrize(
    ("column", "paths"),
    [
        (0, ("/usr/include/x86_64-linux-gnu/asm/unistd_64.h", "/usr/include/asm/unistd_64.h")),
        (1, ("/usr/include/asm-generic/unistd.h",)),
    ],
)
def test_numbers_are_the_kernel_s(column: int, paths: tuple[str, ...]) -> None:
    found = [Path(path) for path in paths if Path(path).exists()]
    if not found:
        pytest.skip(f"no kernel headers here: {paths[0]}")
    numbers = {
        name: int(value)
        for name, value in re.findall(r"#define __NR(?:3264)?_(\w+)\s+(\d+)", found[0].read_text())
    }
    listed = {name: values[column] for name, values in {**DENIED, **FILTERED}.items()}
    assert {name: value for name, value in listed.items() if value is not None} == {
        name: numbers[name] for name, value in listed.items() if value is not None
    }
    # What the table leaves out for an architecture does not exist there.
    assert not {name for name, value in listed.items() if value is None} & set(numbers)


def test_an_unknown_machine_has_no_numbers() -> None:
    with pytest.raises(NotImplementedError, match="no syscall table for riscv64"):
        number("clone", "riscv64")


def test_outcomes_need_a_control() -> None:
    nothing, everything = dict.fromkeys(MEANING, False), dict.fromkeys(MEANING, True)
    assert set(judge(everything, nothing).values()) == {"proved"}
    assert set(judge(nothing, nothing).values()) == {"not proved"}
    assert set(judge(everything, everything).values()) == {"failed"}
    assert set(judge(everything, {}).values()) == {"failed"}


def test_levels() -> None:
    proved = judge(dict.fromkeys(MEANING, True), dict.fromkeys(MEANING, False))
    assert level_of(proved) == "strong"
    assert level_of({**proved, "look_up_file": "failed"}) == "names visible"
    assert level_of({**proved, "read_public_file": "failed"}) == "reads unprotected"
    assert level_of({**proved, "read_private_file": "not proved"}) == "reads unprotected"
    assert level_of({**proved, "fork": "not proved"}) == "weak"
    assert level_of({}) == "weak"


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root")
def test_unused_uids_are_nobody_s_and_differ() -> None:
    first, second = identity.unused_uid(), identity.unused_uid()
    assert first is not None
    assert second is not None
    assert first != second
    owners = set()
    for entry in os.scandir("/proc"):
        if entry.name.isdigit():
            owners.add(os.stat("/proc").st_uid)
    assert not {first, second} & owners
    assert 61_184 <= first <= 65_519


def test_the_grader_is_undumpable_until_the_last_release() -> None:
    from slamcmp.grading.sandbox.walls import kernel

    identity.hold_undumpable()
    identity.hold_undumpable()
    identity.release_undumpable()
    assert kernel.prctl(kernel.PR_GET_DUMPABLE) == 0
    identity.release_undumpable()
    assert kernel.prctl(kernel.PR_GET_DUMPABLE) == 1


def test_readable_files_are_the_package_s_and_no_more() -> None:
    found = readable.readable_for(("numpy", "scipy"))
    names = {os.path.basename(path) for path in found.trees}
    assert {"numpy", "scipy"} <= names
    assert not names & {"slamcmp", "pandas", "site-packages"}
    assert not any("site-packages" in folder for folder, _ in found.libraries)
    assert {masked for _, masked in found.libraries} == {("site-packages", "dist-packages")}


def test_requirements_of_a_package_are_readable_too() -> None:
    names = {os.path.basename(path) for path in readable.readable_for(("pandas",)).trees}
    assert {"pandas", "numpy", "dateutil"} <= names


def test_world_reachable(tmp_path: Path) -> None:
    # pytest's own folder is private; what lies below it is unreachable whatever its rights.
    file = tmp_path / "file"
    file.write_text("x")
    assert world_reachable_like_the_kernel(file) == readable.world_reachable(str(file))
    assert readable.world_reachable("/etc/passwd")
    assert not readable.world_reachable("/etc/shadow")
    assert not readable.world_reachable("/etc/there-is-no-such-file")


def world_reachable_like_the_kernel(path: Path) -> bool:
    if os.geteuid() != 0:
        pytest.skip("needs root to become another user")
    child = os.fork()
    if child == 0:
        os.setgroups([])
        os.setresgid(65534, 65534, 65534)
        os.setresuid(65534, 65534, 65534)
        try:
            path.read_bytes()
        except OSError:
            os._exit(1)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_threads_of_a_library_are_noticed() -> None:
    import threading

    stop = threading.Event()
    thread = threading.Thread(target=stop.wait)
    thread.start()
    try:
        assert identity.has_threads()
    finally:
        stop.set()
        thread.join()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="asks the Linux kernel")
def test_landlock_is_found_where_the_kernel_lists_it() -> None:
    listed = Path("/sys/kernel/security/lsm")
    if not listed.exists():
        pytest.skip("this kernel does not list its security modules")
    if "landlock" in listed.read_text():
        assert landlock_abi() > 0
    else:
        with pytest.raises(OSError) as refused:  # noqa: PT011
            landlock_abi()
        assert refused.value.errno in (errno.ENOSYS, errno.EOPNOTSUPP)


def test_a_layer_that_cannot_be_says_why() -> None:
    def refuse() -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    assert layers._try(refuse) == "not active: [Errno 1] Operation not permitted"
