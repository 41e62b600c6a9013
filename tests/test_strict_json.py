"""JSON from anywhere is bounded and strict; what is wrong with it is one line."""

import os
import pathlib

import pytest

from replay.base.strict_json import JsonError, parse_json, read_json


def test_ordinary_json_is_read(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "good.json"
    path.write_text('{"a": [1, 2.5, null, true, "Höfe"], "b": {"a": -0.0}}', encoding="utf-8")
    assert read_json(path, 1000) == {"a": [1, 2.5, None, True, "Höfe"], "b": {"a": 0.0}}
    assert parse_json("1e-400") == 0.0


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "not JSON"),
        (b"hello", "not JSON"),
        (b'{"schema": "replay.results/1", ', "not JSON"),
        (b"\xff\xfe{}", "not UTF-8 at byte 0"),
        (b"\xef\xbb\xbf{}", "not JSON"),
        (b'{"a": NaN}', "NaN is not JSON"),
        (b'{"a": -Infinity}', "-Infinity is not JSON"),
        (b'{"a": 1e999}', "1e999 is beyond the range"),
        (b'{"a": 1, "a": 2}', "the key 'a' appears twice"),
        (b"[" * 200_000, "nested too deeply"),
        (b'{"a":' * 200_000, "nested too deeply"),
        (b"9" * 10_000, "Exceeds the limit"),
        (b'{"a": "line\nbreak"}', "not JSON"),
    ],
)
def test_what_is_no_strict_json_is_said_in_one_line(tmp_path: pathlib.Path, content: bytes, said: str) -> None:
    path = tmp_path / "bad.json"
    path.write_bytes(content)
    with pytest.raises(JsonError, match=said) as caught:
        read_json(path, 10**7)
    assert "\n" not in str(caught.value)


def test_what_is_no_file_is_said_in_one_line(tmp_path: pathlib.Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path, said in (
        (tmp_path / "missing", "No such file"),
        (tmp_path, "not a file"),
        (tmp_path / "pipe", "not a file"),
    ):
        with pytest.raises(JsonError, match=said):
            read_json(path, 10**7)
    with pytest.raises(JsonError, match="null"):
        read_json("bad\0name", 10**7)


def test_a_file_that_is_too_large_is_not_read(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "large.json"
    path.write_bytes(b"[" + b" " * 100 + b"]")
    assert read_json(path, 102) == []
    with pytest.raises(JsonError, match="larger than 101 bytes"):
        read_json(path, 101)
