"""Numbers next to zero: native code takes those below the smallest normal one as zero, as
processors are many times slower at them, so that a motion that dies away stays as quick as it was.
On x86; elsewhere such numbers are kept.
"""

from __future__ import annotations

import platform

X86 = ("x86_64", "amd64", "i386", "i686", "x86")
FLUSH = 0x8040  # bits of the control register: results, and operands, are zero


def flushing(name: str, called: str) -> str:
    """Text of `name(ptr)`, which calls `called(ptr)` so, and leaves the thread's control register
    as it was.
    """
    if platform.machine().lower() not in X86:
        return (
            f'define void @"{name}"(ptr %args) nounwind {{\n  call void @"{called}"(ptr '
            "%args)\n  ret void\n}"
        )
    # fmt: off
    return "\n".join((
        "declare void @llvm.x86.sse.stmxcsr(ptr)", "declare void @llvm.x86.sse.ldmxcsr(ptr)", "",
        f'define void @"{name}"(ptr %args) nounwind {{', "  %kept = alloca i32",
        "  %set = alloca i32",
        "  call void @llvm.x86.sse.stmxcsr(ptr %kept)", "  %old = load i32, ptr %kept",
        f"  %new = or i32 %old, {FLUSH}",
        "  store i32 %new, ptr %set", "  call void @llvm.x86.sse.ldmxcsr(ptr %set)",
        f'  call void @"{called}"(ptr %args)',
        "  call void @llvm.x86.sse.ldmxcsr(ptr %kept)", "  ret void", "}"))
    # fmt: on
