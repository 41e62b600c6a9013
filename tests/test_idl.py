"""Definitions in IDL: what is understood of them, and that nothing in them costs more than a pass over the text."""

import time

import logs_maker as make
import pytest
from idl_maker import idl

from replay.logs.messages.definition import matching_definition
from replay.logs.messages.idl import MAX_DEPTH, MAX_FIELDS, MAX_TYPES, parse_idl
from replay.logs.messages.ros2 import MESSAGE_TYPES
from replay.logs.messages.types import DefinitionError


@pytest.mark.parametrize("kind", sorted(MESSAGE_TYPES))
def test_every_type_is_known_by_its_idl_too(kind: str) -> None:
    assert matching_definition(kind, idl(kind).encode(), MESSAGE_TYPES[kind].standards, "ros2idl") == 0


def test_a_changed_idl_is_told_by_its_first_difference() -> None:
    changed = idl(make.GRID).replace("float resolution", "double resolution")
    with pytest.raises(DefinitionError, match="'float64 resolution', expected 'float32 resolution'"):
        matching_definition(make.GRID, changed.encode(), MESSAGE_TYPES[make.GRID].standards, "ros2idl")


def test_all_types_that_ros_writes_in_idl_are_understood() -> None:
    text = """
    /* one
       comment */ // another
    #include "a.idl"
    module a { module msg {
      module T_Constants { const unsigned long long N = 5; const string S = "};"; };
      typedef double double__36[36];
      @verbatim (language="comment", text="a (b) \\" }" "and more")
      struct T {
        @default (value=3) @key octet a; unsigned long long b; long c; unsigned short d; long long e;
        string<12> f; wstring g; boolean h; sequence<b::msg::U, 7> i; sequence<octet> j; double__36 k; U l; char m[4];
      };
    }; };
    """
    kinds = ["uint8", "uint64", "int32", "uint16", "int64", "string", "wstring", "bool", "b/U[<=7]", "uint8[]"]
    kinds += ["float64[36]", "a/U", "uint8[4]"]
    assert parse_idl(text) == {"a/T": list(zip(kinds, "abcdefghijklm", strict=True))}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("module a {", "not closed"),
        ("module a { struct", "ends in the middle"),
        ("struct S { double x }", "where"),
        ("struct S { double x; }; struct S { double y; };", "twice"),
        ("struct 5 {", "a name"),
        ("struct S { double x[n]; };", "a size"),
        ("struct S { sequence<sequence<double>> x; };", "where"),
        ("union U { };", "expected"),
        ('@verbatim (text="never closed', "never closed"),
        ("/* never closed", "never closed"),
        ("module m {" * (MAX_DEPTH + 1), "modules within"),
        ("struct S {" + "double x;" * (MAX_FIELDS + 1) + "};", "fields"),
        ("".join(f"struct S{i} {{}};" for i in range(MAX_TYPES + 1)), "types"),
        ("".join(f"typedef double t{i}[3];" for i in range(MAX_FIELDS + 1)), "typedefs"),
    ],
)
def test_what_is_not_understood_is_an_error_of_one_line(text: str, says: str) -> None:
    with pytest.raises(DefinitionError, match=says) as caught:
        parse_idl(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("piece", ['"', "/*", '\\"', '"\\', "@x(", "sequence<", "unsigned ", "a::", "[", "=", "9" * 50])
def test_no_text_takes_long(piece: str) -> None:
    text = "struct S { " + piece * (250_000 // len(piece))
    started = time.process_time()
    with pytest.raises(DefinitionError):
        parse_idl(text)
    assert time.process_time() - started < 10.0, "coverage slows it several times; more than in proportion is hours"
