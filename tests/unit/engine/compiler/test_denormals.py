"""Numbers next to zero in native code, and after it."""

import ctypes
import platform
import sys

import pytest

from torchbeam.engine.compiler.denormals import X86, flushing
from torchbeam.engine.compiler.library import Library

pytest.importorskip("llvmlite")
HALVED = """define void @"halved"(ptr %x) noinline nounwind {
  %a = load double, ptr %x
  %b = fmul double %a, 0.5
  store double %b, ptr %x
  ret void
}
"""


def test_a_number_next_to_zero_is_zero_within_and_stays_without():
    library = Library(HALVED + flushing("run", "halved"))
    tiny = sys.float_info.min
    for name, left in (
        ("run", 0.0 if platform.machine().lower() in X86 else tiny / 2),
        ("halved", tiny / 2),
    ):
        x = ctypes.c_double(tiny)
        ctypes.CFUNCTYPE(None, ctypes.c_void_p)(library.address(name))(ctypes.addressof(x))
        assert x.value == left
        x = ctypes.c_double(3.0)
        ctypes.CFUNCTYPE(None, ctypes.c_void_p)(library.address(name))(ctypes.addressof(x))
        assert x.value == 1.5
    assert tiny / 2 > 0
