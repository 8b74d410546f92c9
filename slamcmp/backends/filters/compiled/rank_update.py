"""``P -= W^T W`` on one triangle of P: BLAS's ``dsyrk``, called from compiled code, or plain loops.

scipy publishes the address of its BLAS for Cython; a kernel gets it as a number, for an address in the code
itself could not be kept on disk.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numba as nb
from llvmlite import ir
from numba.core import cgutils
from numba.extending import intrinsic
from scipy.linalg import cython_blas

from slamcmp.backends.filters.compiled.compiling import compiled
from slamcmp.types import FloatArray

PLAIN_BELOW = 32
"""States below which plain loops are done sooner than BLAS."""
_EXPECTED = "void (char *, char *, int *, int *"
"""How scipy's declaration begins where BLAS counts in 32 bits."""


def blas_address() -> int:
    """Where ``dsyrk`` is in this process; 0 where it is not of the kind that is called here."""
    capsule = cython_blas.__pyx_capi__.get("dsyrk")
    if capsule is None:
        return 0
    name_of = ctypes.pythonapi.PyCapsule_GetName
    name_of.restype, name_of.argtypes = ctypes.c_char_p, [ctypes.py_object]
    name = name_of(capsule)
    if name is None or not name.decode().startswith(_EXPECTED):
        return 0
    address_of = ctypes.pythonapi.PyCapsule_GetPointer
    address_of.restype, address_of.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return int(address_of(capsule, name) or 0)


@intrinsic  # type: ignore[untyped-decorator]
def _dsyrk(_context: Any, _address: Any, _n: Any, _k: Any, _W: Any, _ldw: Any, _P: Any, _ldp: Any) -> Any:
    """dsyrk('L', 'N', n, k, -1, W, ldw, 1, P, ldp) of the BLAS at an address, on two arrays' addresses."""
    signature = nb.void(*[nb.int64] * 7)

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        address, n, k, W, ldw, P, ldp = arguments
        integer, real, letter = ir.IntType(32), ir.DoubleType(), ir.IntType(8)

        def by_reference(value: Any) -> Any:
            return cgutils.alloca_once_value(builder, value)

        def count(value: Any) -> Any:
            return by_reference(builder.trunc(value, integer))

        pointers = [
            by_reference(ir.Constant(letter, ord("L"))),
            by_reference(ir.Constant(letter, ord("N"))),
            count(n),
            count(k),
            by_reference(ir.Constant(real, -1.0)),
            builder.inttoptr(W, real.as_pointer()),
            count(ldw),
            by_reference(ir.Constant(real, 1.0)),
            builder.inttoptr(P, real.as_pointer()),
            count(ldp),
        ]
        kind = ir.FunctionType(ir.VoidType(), [pointer.type for pointer in pointers])
        builder.call(builder.inttoptr(address, kind.as_pointer()), pointers)
        return context.get_dummy_value()

    return signature, generate


@compiled()
def downdate(P: FloatArray, n: int, W: FloatArray, blas: int) -> None:
    """``P -= W^T W`` on the upper triangle of the first n rows and columns; W is (k, n)."""
    k = len(W)
    if blas != 0 and n >= PLAIN_BELOW:
        # A row here is a column there, and the upper triangle the lower one.
        _dsyrk(blas, n, k, W.ctypes.data, n, P.ctypes.data, P.shape[1])
        return
    for i in range(n):
        # From 0 on, a loop is one that the compiler can do several columns of at a time.
        row, a = P[i, i:n], 0
        # Four rows of W at a time: P is read and written a quarter as often.
        while a + 4 <= k:
            W0, W1, W2, W3 = W[a, i:], W[a + 1, i:], W[a + 2, i:], W[a + 3, i:]
            w0, w1, w2, w3 = W0[0], W1[0], W2[0], W3[0]
            for j in range(n - i):
                row[j] -= w0 * W0[j] + w1 * W1[j] + w2 * W2[j] + w3 * W3[j]
            a += 4
        while a < k:
            W0 = W[a, i:]
            w0 = W0[0]
            for j in range(n - i):
                row[j] -= w0 * W0[j]
            a += 1
