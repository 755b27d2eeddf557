# SPDX-License-Identifier: GPL-3.0-or-later
"""The ctypes mirror says what the header says: a mirror that drifts corrupts memory in silence."""

import ctypes
import re

import pytest
from amberlight.binding import _ffi, errors
from conftest import HEADER

TEXT = re.sub(r"/\*.*?\*/", "", HEADER.read_text(), flags=re.DOTALL)

SCALARS = {
    "float": ctypes.c_float,
    "double": ctypes.c_double,
    "int32_t": ctypes.c_int32,
    "uint32_t": ctypes.c_uint32,
    "uint64_t": ctypes.c_uint64,
    "char": ctypes.c_char,
    "AmbStatus": ctypes.c_int32,
}


def number(text):
    """A constant expression of the header: a number, a shift or a known name."""
    text = text.strip()
    return getattr(_ffi, text) if text.startswith("AMB_") else eval(text, {"__builtins__": {}})


def struct_bodies():
    return dict(re.findall(r"typedef struct (\w+) \{(.*?)\} \1;", TEXT, re.DOTALL))


def fields_of(body):
    """(name, ctypes type) of each member, several to a declaration included."""
    for declaration in filter(str.strip, body.split(";")):
        const, kind, names = re.match(r"\s*(const )?(\w+)\s+(.*)", declaration, re.DOTALL).groups()
        for name in names.split(","):
            name = name.strip()
            is_pointer = name.startswith("*")
            assert is_pointer == bool(const), declaration
            match = re.match(r"\*?(\w+)(?:\[(\w+)\])?$", name)
            base = SCALARS.get(kind) or getattr(_ffi, kind)
            if is_pointer:
                base = ctypes.c_char_p if kind == "char" else ctypes.POINTER(base)
            if match[2]:
                base = base * number(match[2])
            yield match[1], base


def test_constants():
    pairs = re.findall(r"\b(AMB_\w+) = ([^,}\n]+)", TEXT)
    assert len(pairs) > 30
    for name, value in pairs:
        assert getattr(_ffi, name) == number(value), name


def test_definitions():
    pairs = re.findall(r"^#define (AMB_[A-Z_]+) (\d+|\"[^\"]*\")$", TEXT, re.MULTILINE)
    assert {name for name, _ in pairs} == {
        "AMB_ABI_VERSION", "AMB_VERSION_STRING", "AMB_PHASE_LOBE_MAX",
    }  # fmt: skip
    for name, value in pairs:
        assert getattr(_ffi, name) == eval(value), name


def test_no_other_constants():
    names = {n for n, v in vars(_ffi).items() if n.startswith("AMB_") and isinstance(v, (int, str))}
    assert not [name for name in names if name not in TEXT and f"X({name[4:]}," not in TEXT]


def test_status_list():
    statuses = re.findall(r"X\((\w+), (\d+), \"", TEXT)
    assert len(statuses) == 8
    for name, value in statuses:
        assert getattr(_ffi, f"AMB_{name}") == int(value)
    # Each failure has its exception.
    assert set(errors.CLASSES) == {int(value) for _, value in statuses} - {_ffi.AMB_OK}


@pytest.mark.parametrize("name", struct_bodies())
def test_struct(name):
    assert list(getattr(_ffi, name)._fields_) == list(fields_of(struct_bodies()[name]))


def test_struct_ids():
    ids = {
        f"AMB_STRUCT_{re.sub(r'(?<!^)(?=[A-Z])', '_', name[3:]).upper()}": name
        for name in struct_bodies()
    }
    assert {getattr(_ffi, key): getattr(_ffi, name) for key, name in ids.items()} == _ffi.STRUCT_IDS
    assert len(_ffi.STRUCT_IDS) == _ffi.AMB_STRUCT_COUNT


def parameter_type(text):
    """ctypes type of a parameter as the header writes it."""
    text = text.strip()
    if text == "char *buffer":
        return ctypes.c_void_p
    kind, stars, name, array = re.match(r"(?:const )?(\w+) ?(\**)(\w*)(\[\d*\])?$", text).groups()
    depth = len(stars) + bool(array)
    if kind in {"AmbScene", "AmbRender"}:
        base, depth = ctypes.c_void_p, depth - 1
    elif kind == "char" and depth == 1:
        return ctypes.c_char_p
    else:
        base = SCALARS.get(kind) or getattr(_ffi, kind)
    return ctypes.POINTER(base) if depth == 1 else base


def test_functions():
    declared = re.findall(r"^AMB_API ([\w ]+?[ *]+)(\w+)\((.*?)\);", TEXT, re.DOTALL | re.MULTILINE)
    assert [name for _, name, _ in declared] == list(_ffi.FUNCTIONS)
    for result, name, parameters in declared:
        restype, argtypes = _ffi.FUNCTIONS[name]
        result = result.strip()
        if result == "AmbStatus":
            assert restype is _ffi.AmbStatus, name
        elif result == "void":
            assert restype is None, name
        else:
            assert restype is parameter_type(result), name
        texts = [] if parameters.strip() == "void" else parameters.split(",")
        assert list(argtypes) == [parameter_type(" ".join(t.split())) for t in texts], name


def test_compiled_sizes(fake):
    """The compiler's layout, not only our reading of the header."""
    for struct_id, struct in _ffi.STRUCT_IDS.items():
        assert fake.amb_struct_size(struct_id) == ctypes.sizeof(struct)
