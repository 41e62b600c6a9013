"""Documents are read strictly into structs; what is wrong is one line that names the field."""

import dataclasses
import enum
import json
import math
import pathlib
from typing import Any, Literal

import msgspec
import numpy as np
import pytest

from replay.base.documents import (
    Count,
    DocumentError,
    Number,
    Whole,
    convert,
    parse_json,
    parse_toml,
    plain,
    read_json,
    read_toml,
    to_bytes,
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Truck:
    wheelbase: float = 3.6

    def __post_init__(self) -> None:
        if self.wheelbase <= 0.0:
            raise ValueError(f"wheelbase is {self.wheelbase}, expected more than 0")


class Entry(msgspec.Struct, frozen=True, kw_only=True):
    name: str
    status: Literal["improved", "kept"] = "kept"
    kind: str | msgspec.UnsetType = msgspec.field(name="class", default=msgspec.UNSET)
    cusps: Count = 0
    metrics: dict[str, Number] = msgspec.field(default_factory=dict)
    place: "Place | None" = None
    truck: Truck = Truck()


class Place(msgspec.Struct, frozen=True, kw_only=True):
    s: float
    index: Whole = 0


class Run(msgspec.Struct, frozen=True, kw_only=True):
    methods: tuple[Entry, ...] = ()
    seed: Whole = 0
    raw: dict[str, Any] = msgspec.field(default_factory=dict)


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    tries: Whole = 1
    time_limit: float = math.inf


HUGE = "1" + "0" * 400


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[1]", "the document is a list, expected an object"),
        ('{"methods": {}}', "methods is an object, expected a list"),
        ('{"methods": [{"name": "a"}, {}]}', "methods[1].name is missing"),
        ('{"methods": [{"name": 3}]}', "methods[0].name is 3, expected a text"),
        ('{"methods": [{"name": null}]}', "methods[0].name is null, expected a text"),
        (
            '{"methods": [{"name": "a", "status": "odd"}]}',
            "methods[0].status is 'odd', expected 'improved' or 'kept'",
        ),
        ('{"methods": [{"name": "a", "class": 1.5}]}', "methods[0].class is 1.5, expected a text"),
        (
            '{"methods": [{"name": "a", "metrics": {"b": 1, "length": "x"}}]}',
            "methods[0].metrics.length is 'x', expected a number or null",
        ),
        ('{"methods": [{"name": "a", "cusps": 2.5}]}', "methods[0].cusps is 2.5, expected a whole number"),
        ('{"methods": [{"name": "a", "place": {"s": true}}]}', "methods[0].place.s is true, expected a number"),
        ('{"methods": [{"name": "a", "place": 3}]}', "methods[0].place is 3, expected an object or null"),
        (
            '{"methods": [{"name": "a", "truck": {"wheelbase": -1}}]}',
            "methods[0].truck: wheelbase is -1.0, expected more than 0",
        ),
        ('{"seed": 1, "seed": 2}', "the key 'seed' appears twice"),
        ('{"seed": NaN}', "NaN is not JSON, expected a number or null"),
    ],
)
def test_what_is_wrong_is_said_with_the_place_of_the_field(text: str, said: str) -> None:
    with pytest.raises(DocumentError) as caught:
        parse_json(text, Run)
    assert str(caught.value) == said


@pytest.mark.parametrize(
    ("text", "place"),
    [
        (f'{{"seed": {HUGE}}}', "seed"),
        (f'{{"seed": -{HUGE}}}', "seed"),
        (f'{{"methods": [{{"name": "a", "cusps": {HUGE}}}]}}', "methods[0].cusps"),
        (f'{{"methods": [{{"name": "a", "metrics": {{"length": {HUGE}}}}}]}}', "methods[0].metrics.length"),
        (f'{{"methods": [{{"name": "a", "place": {{"s": {HUGE}}}}}]}}', "methods[0].place.s"),
        (f'{{"methods": [{{"name": "a", "truck": {{"wheelbase": {HUGE}}}}}]}}', "methods[0].truck.wheelbase"),
        ('{"methods": [{"name": "a", "place": {"s": 1e400}}]}', "methods[0].place.s: 1e400 is beyond the range"),
    ],
)
def test_a_number_of_four_hundred_digits_is_refused_with_the_name_of_its_field(text: str, place: str) -> None:
    with pytest.raises(DocumentError) as caught:
        parse_json(text, Run)
    assert str(caught.value).startswith(place)
    assert len(str(caught.value)) < 120


@pytest.mark.parametrize("number", [HUGE, "-" + HUGE, "1e400", "-1e400"])
@pytest.mark.parametrize("key", ["tries", "time_limit"])
def test_toml_with_a_number_of_four_hundred_digits_names_its_key(key: str, number: str) -> None:
    with pytest.raises(DocumentError, match=rf"^table.{key} is a number of 401 digits, expected a (whole )?number"):
        convert(parse_toml(f"{key} = {number}"), Table, "table")


def test_toml_may_say_that_there_is_no_limit() -> None:
    assert convert(parse_toml("time_limit = inf"), Table).time_limit == math.inf
    assert convert(parse_toml("time_limit = 3"), Table).time_limit == 3.0


def test_an_unknown_key_of_what_people_write_is_refused_with_the_nearest_one() -> None:
    with pytest.raises(
        DocumentError, match=r"unknown key 'trys' in \[ddp\]. Did you mean 'tries'\? There are: tries, t"
    ):
        convert({"trys": 3}, Table, "[ddp]")
    assert parse_json('{"more": 1, "seed": 3}', Run).seed == 3


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"a = ", "not TOML"),
        (b"a = " + b"9" * 5000, "Exceeds the limit"),
        (b"a = " + b"[" * 100_000, "nested too deeply|not TOML"),
        (b"\xff", "not UTF-8"),
        (b"\x89MCAP0", "not TOML: it is an MCAP log"),
    ],
)
def test_what_is_no_toml_is_said_in_one_line(tmp_path: pathlib.Path, content: bytes, said: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    with pytest.raises(DocumentError, match=said) as caught:
        read_toml(path)
    assert "\n" not in str(caught.value)


def test_keys_and_texts_that_are_half_a_character_do_no_harm() -> None:
    with pytest.raises(DocumentError, match="a key is not valid text"):
        parse_json(r'{"\ud800": 1}', Run)
    assert parse_json(r'{"methods": [{"name": "\udcff"}]}', Run).methods[0].name == "\udcff"


class Colour(enum.Enum):
    RED = "red"


def test_what_is_written_is_plain_sorted_and_comes_back(tmp_path: pathlib.Path) -> None:
    entry = Entry(name="Höfe_\udcff", metrics={"b": math.inf, "a": 0.1}, place=Place(s=math.nan))
    raw = {"f": np.float64(0.1), "i": np.int64(3), "a": np.array([1.0, np.nan]), "b": np.bool_(True)}
    document = Run(methods=(entry,), raw=raw | {"e": Colour.RED, "p": pathlib.Path("x/y"), "t": (1, 2)})
    content = to_bytes(document)
    assert content.startswith(b'{"methods":[{"cusps":0,"metrics":{"a":0.1,"b":null},"name":"H\xc3\xb6fe_\\udcff"')
    assert content.endswith(b"}\n")
    assert b"class" not in content, "what is unset is not written"
    expected = {"a": [1.0, None], "b": True, "e": "red", "f": 0.1, "i": 3, "p": "x/y", "t": [1, 2]}
    assert json.loads(content)["raw"] == expected
    again = read_json(_file(tmp_path, to_bytes(Run(methods=(Entry(name="a", kind="b"),)))), Run, 1000)
    assert again == Run(methods=(Entry(name="a", kind="b"),))
    with pytest.raises(TypeError, match="complex cannot be written to a document"):
        plain({"extra": 1j})


def _file(folder: pathlib.Path, content: bytes) -> pathlib.Path:
    path = folder / "document.json"
    path.write_bytes(content)
    return path


def test_what_is_no_file_or_too_large_is_a_document_error(tmp_path: pathlib.Path) -> None:
    for path in (tmp_path, tmp_path / "missing"):
        with pytest.raises(DocumentError):
            read_json(path, Run, 1000)
    with pytest.raises(DocumentError, match="larger than 5 bytes"):
        read_json(_file(tmp_path, b'{"seed": 1}'), Run, 5)
