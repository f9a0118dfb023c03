"""``tools/vcan_guest`` where the CPU has a longer register area than user-mode Linux knows (AMX).

Few CPUs have one, but the host's kernel refuses a part of the area on all of them. So a library
between linux.uml and ``ptrace`` cuts off the area's end, and what then fails or works is real.
"""

import ctypes
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2] / "tools" / "vcan_guest_xstate.c"
SHORTER = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdarg.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

long ptrace(enum __ptrace_request request, ...)
{
    va_list arguments;
    va_start(arguments, request);
    long pid = va_arg(arguments, long);
    long kind = va_arg(arguments, long);
    long data = va_arg(arguments, long);
    va_end(arguments);
    if ((request == PTRACE_GETREGSET || request == PTRACE_SETREGSET) && kind == 0x202) {
        static char area[65536];
        struct iovec whole = {area, sizeof area}, *part = (struct iovec *)data;
        syscall(SYS_ptrace, PTRACE_GETREGSET, pid, kind, &whole);
        if (part->iov_len > whole.iov_len - 64)
            part->iov_len = whole.iov_len - 64;
    }
    return ((long (*)(int, ...))dlsym(RTLD_NEXT, "ptrace"))(request, pid, kind, data);
}
"""
WITHOUT_AVX = {"OPENBLAS_CORETYPE": "Nehalem", "NPY_DISABLE_CPU_FEATURES": "X86_V3"}
"""For numpy. Where no registers follow those of AVX, these are what is cut off."""
REFUSAL = "userspace - ptrace set fp regs failed, errno = 14"
PANIC = "Kernel panic - not syncing: Kernel mode signal 11"


@pytest.fixture
def library(tmp_path):
    """Compiles C to a library to be preloaded."""
    if shutil.which("cc") is None and os.environ.get("CAN_RIG_VCAN") != "required":
        pytest.skip("NOT TESTED: no C compiler here: apt-get install gcc libc6-dev")

    def build(source, name):
        path = tmp_path / f"{name}.so"
        command = ["cc", "-shared", "-fPIC", "-O2", "-Wall", "-Wextra", "-Werror", "-xc"]
        subprocess.run([*command, "-o", path, "-"], input=source, text=True, check=True, timeout=60)
        return path

    return build


@pytest.fixture
def environment(tmp_path):
    """A PATH that begins with the test's own tools, and a cache that is empty."""
    tools = tmp_path / "tools"
    tools.mkdir()
    path = f"{tools}:{os.environ['PATH']}:/usr/sbin:/sbin"
    return {"PATH": path, "XDG_CACHE_HOME": str(tmp_path / "cache")}


def tool(environment, name, script):
    """Put a program first in PATH; ``$real`` is the hidden program."""
    folder = Path(environment["PATH"].partition(":")[0])
    path = folder / name
    path.write_text(f"#!/bin/bash\nreal={shutil.which(name)}\n{script}")
    path.chmod(0o755)


# --- the library ---------------------------------------------------------------------------------


class Part(ctypes.Structure):
    """``struct iovec``."""

    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


def test_a_part_of_the_registers_is_written_and_the_rest_stays(library):
    """To a process that is stopped; without the library the kernel takes all or nothing."""
    plain = ctypes.CDLL(None, use_errno=True).ptrace
    helped = ctypes.CDLL(str(library(SOURCE.read_text(), "xstate")), use_errno=True).ptrace
    for each in (plain, helped):
        each.restype = ctypes.c_long
        each.argtypes = [ctypes.c_long] * 3 + [ctypes.c_void_p]
    attach, peek, detach, read, write, xstate = 16, 1, 17, 0x4204, 0x4205, 0x202

    def registers(call, request, area, length):
        part = Part(ctypes.addressof(area), length)
        return call(request, child.pid, xstate, ctypes.addressof(part)), part.length

    with subprocess.Popen(["sleep", "60"]) as child:
        try:
            assert helped(attach, child.pid, 0, None) == 0
            os.waitpid(child.pid, 0)
            before, after, short = (ctypes.create_string_buffer(65536) for _ in range(3))
            status, whole = registers(helped, read, before, 65536)
            assert status == 0
            assert whole > 576
            part = whole - 64
            ctypes.memmove(short, before, part)
            short[512] = bytes([short.raw[512] | 2])  # SSE in use
            short[160:176] = bytes(range(16))  # xmm0
            assert registers(plain, write, short, part)[0] == -1
            assert registers(helped, write, short, part)[0] == 0
            assert registers(plain, read, after, 65536) == (0, whole)
            assert after.raw[160:176] == bytes(range(16))
            assert after.raw[576:whole] == before.raw[576:whole]
            address = int(Path(f"/proc/{child.pid}/maps").read_text().partition("-")[0], 16)
            with Path(f"/proc/{child.pid}/mem").open("rb", buffering=0) as memory:
                memory.seek(address)
                word = int.from_bytes(memory.read(8), "little", signed=True)
            assert helped(peek, child.pid, address, None) == word
            assert helped(detach, child.pid, 0, None) == 0
        finally:
            child.kill()


# --- a kernel that needs it ----------------------------------------------------------------------


FAKE = f"""
for word; do case $word in VCAN_GUEST=*) folder=${{word#*=}} ;; esac; done
echo "$LD_PRELOAD" >> "$MY_CALLS"
grep -c xstate "$folder/command" >> "$MY_CALLS"
if ! grep -q xstate <<< "$LD_PRELOAD"; then
    echo "{REFUSAL}" >&2; echo "{PANIC}" >&2; exit 134
fi
echo 7 > "$folder/status"
"""


@pytest.fixture
def fake(guest, environment, tmp_path):
    """A kernel that fails as on a CPU with AMX, and what it was started with."""
    tool(environment, "linux.uml", FAKE)
    calls = tmp_path / "calls"

    def run(**more):
        calls.write_text("")
        process = guest("true", env={**environment, "MY_CALLS": str(calls), **more})
        _, err = process.communicate(timeout=120)
        return process.returncode, err, calls.read_text().split("\n")[:-1]

    return run


def test_the_kernel_is_started_again_with_the_library_and_from_then_on_at_once(
    fake, library, tmp_path
):
    status, err, calls = fake()
    (built,) = (tmp_path / "cache").glob("*/*")
    assert (status, err) == (7, "")
    assert calls == ["", "0", str(built), "0"]  # the environment of COMMAND lacks the library
    assert fake(LD_PRELOAD="")[2] == [str(built), "0"]


# --- the real kernel -----------------------------------------------------------------------------


def test_the_numbers_of_processes_that_take_turns_are_right(guest, environment, library, tmp_path):
    """On a CPU with a longer area than the kernel keeps."""
    cut = library(SHORTER, "shorter")
    preload = f"LD_PRELOAD={cut}${{LD_PRELOAD:+:$LD_PRELOAD}}"
    tool(environment, "linux.uml", f'exec env "{preload}" "$real" "$@"')
    environment.update(WITHOUT_AVX)
    script = 'echo "${LD_PRELOAD-none}"; exec "$@"'
    python = [sys.executable, Path(__file__).with_name("registers.py")]
    environment["OPENBLAS_NUM_THREADS"] = "1"
    same = {**os.environ, **environment}
    here = subprocess.run(python, env=same, capture_output=True, text=True, check=True)
    process = guest("--timeout", 300, "bash", "-c", script, "x", *python, env=environment)
    out, err = process.communicate(timeout=320)
    assert (process.returncode, err) == (0, "")
    said, *digests = out.split()
    assert said == "none"
    assert digests == here.stdout.split()
    assert len(list((tmp_path / "cache").glob("*/*"))) == 1
