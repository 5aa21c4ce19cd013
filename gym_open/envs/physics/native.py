"""Call MuJoCo from compiled code: the address of `mj_step`, the offsets of struct fields, and memory access by address.

A step is many substeps. If Python called each of them, threads would wait for the interpreter lock; compiled code that
calls `mj_step` never needs the lock. `mujoco.introspect` lists the fields of structs, ctypes lays them out as C does,
and `layout` compares the result with MuJoCo's Python views once per process.

A fatal error of MuJoCo ends the process here, whereas MuJoCo's Python functions would raise. It happens when the memory
for contacts is full; random exploration uses 1/25 of that memory.
"""

import ctypes
import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, cast

import mujoco
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from gym_open.errors import GymOpenError

_PROBE = """
<mujoco>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body pos="0 0 0.09"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body>
  </worldbody>
</mujoco>
"""
"""A box on a plane: four contacts."""

_NUMBERS = {
    "int": ctypes.c_int,
    "mjtNum": ctypes.c_double,
    "mjtSize": ctypes.c_int64,
    "mjtBool": ctypes.c_bool,
    "size_t": ctypes.c_size_t,
    "uint64_t": ctypes.c_uint64,
    "uintptr_t": ctypes.c_void_p,
}


class LayoutError(GymOpenError):
    """The memory layout of the installed MuJoCo differs from its own description."""


class Layout(NamedTuple):
    """Offsets in bytes of the fields that a step reads, and addresses of functions; compiled code takes this tuple."""

    mj_step: int
    mju_rotVecQuat: int  # noqa: N815  # the name in MuJoCo
    ncon: int
    """Offset in mjData, like the next two."""
    contact: int
    efc_force: int
    contact_size: int
    """Size of one mjContact in bytes."""
    pos: int
    """Offset in mjContact, like the next three."""
    frame: int
    geom: int
    efc_address: int


@functools.cache
def layout() -> Layout:
    """Find the offsets, and compare them with the Python views of a box on a plane.

    Raises:
        LayoutError: if they disagree.
    """
    from mujoco.introspect.structs import STRUCTS

    data, contact = _struct(STRUCTS, "mjData"), _struct(STRUCTS, "mjContact")
    found = Layout(
        mj_step=_address_of("mj_step"),
        mju_rotVecQuat=_address_of("mju_rotVecQuat"),
        ncon=data.ncon.offset,
        contact=data.contact.offset,
        efc_force=data.efc_force.offset,
        contact_size=ctypes.sizeof(contact),
        pos=contact.pos.offset,
        frame=contact.frame.offset,
        geom=contact.geom.offset,
        efc_address=contact.efc_address.offset,
    )
    check(found)
    return found


def _struct(structs: Mapping[str, Any], name: str) -> Any:
    """The ctypes structure of a MuJoCo struct: ctypes pads between fields as C does."""
    fields = [(field.name, _type(structs, field.type)) for field in structs[name].fields]
    return type(name, (ctypes.Structure,), {"_fields_": fields})


def _type(structs: Mapping[str, Any], declared: Any) -> Any:
    kind = type(declared).__name__
    if kind == "PointerType":
        return ctypes.c_void_p
    if kind == "ArrayType":
        count = int(np.prod(declared.extents))
        return _type(structs, declared.inner_type) * count
    return _NUMBERS.get(declared.name) or _struct(structs, declared.name)


def _address_of(function: str) -> int:
    # The bindings are linked to the only libmujoco of this process, so they find the name.
    from mujoco import _functions

    library = ctypes.CDLL(_functions.__file__)
    return ctypes.cast(getattr(library, function), ctypes.c_void_p).value or 0


def check(found: Layout) -> None:
    """Raise LayoutError unless the offsets agree with the Python views of a box on a plane, and `mj_step` steps."""
    model = mujoco.MjModel.from_xml_string(_PROBE)
    data = mujoco.MjData(model)
    step = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(found.mj_step)
    step(model._address, data._address)  # noqa: SLF001
    base, contact = data._address, data.contact  # noqa: SLF001
    first = address(contact.dist)
    for what, read, view in (
        ("time after mj_step", data.time, model.opt.timestep),
        ("mjData.ncon", ctypes.c_int.from_address(base + found.ncon).value, 4),
        ("mjData.contact", ctypes.c_void_p.from_address(base + found.contact).value, first),
        ("mjData.efc_force", ctypes.c_void_p.from_address(base + found.efc_force).value, address(data.efc_force)),
        ("size of mjContact", found.contact_size, contact.pos.strides[0]),
        ("mjContact.pos", first + found.pos, address(contact.pos)),
        ("mjContact.frame", first + found.frame, address(contact.frame)),
        ("mjContact.geom", first + found.geom, address(contact.geom)),
        ("mjContact.efc_address", first + found.efc_address, address(contact.efc_address)),
    ):
        if read != view:
            raise LayoutError(
                f"mujoco {mujoco.__version__}: {what}: expected {view}, found {read}: its memory layout is "
                f"not the one in mujoco.introspect; install the version of mujoco that gym-open requires"
            )


def address(view: np.ndarray) -> int:
    """Memory address of an array's first element."""
    return view.__array_interface__["data"][0]


def _pointer(_: Any, _address: Any) -> Any:
    def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return builder.inttoptr(values[0], context.get_value_type(types.voidptr))

    return types.voidptr(types.int64), generate


def _call_with(count: int) -> Any:
    def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        word = ir.IntType(64)
        kind = ir.FunctionType(ir.VoidType(), [word] * count)
        builder.call(builder.inttoptr(values[0], kind.as_pointer()), values[1:])
        return context.get_dummy_value()

    return types.void(*[types.int64] * (1 + count)), generate


def _call2(_: Any, _function: Any, _first: Any, _second: Any) -> Any:
    return _call_with(2)


def _call3(_: Any, _function: Any, _first: Any, _second: Any, _third: Any) -> Any:
    return _call_with(3)


pointer = cast("Callable[[int], Any]", intrinsic(_pointer))
"""In compiled code: an address as a pointer, from which `carray` makes an array."""
call2 = cast("Callable[[Any, Any, Any], None]", intrinsic(_call2))
"""In compiled code: call the C function at an address with two pointers, both given as addresses."""
call3 = cast("Callable[[Any, Any, Any, Any], None]", intrinsic(_call3))
"""As `call2`, with three pointers."""
