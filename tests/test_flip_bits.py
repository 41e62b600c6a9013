"""Reading damaged versions of a log, each prefix and each flipped bit: what counts as wrong, and that nothing is."""

import pytest

from tools.attacks.flip_bits import FORMS, Read, judged, messages, small_log, sweep

SAID = frozenset({"W_TRUNCATED"})
SOUND = Read(["a", "b"], frozenset())


@pytest.mark.parametrize("form", FORMS)
def test_one_in_sixteen_flipped_bits_alters_nothing(form: str) -> None:
    data = small_log(form)
    found = dict(sweep("flipped bits", data, messages, range(5, 8 * len(data), 17), 1))
    assert len(found) > 900
    assert not {place: verdict for place, verdict in found.items() if verdict.startswith("WRONG")}
    assert {"read in part with a remark", "read whole with a remark", "refused"} == set(found.values())


@pytest.mark.parametrize("form", FORMS)
def test_one_in_nine_prefixes_gives_the_first_messages(form: str) -> None:
    data = small_log(form)
    found = dict(sweep("prefixes", data, messages, range(0, len(data), 9), 1))
    assert not {place: verdict for place, verdict in found.items() if verdict.startswith("WRONG")}


@pytest.mark.parametrize(
    ("damage", "read", "verdict"),
    [
        ("flipped bits", Read(None, frozenset()), "refused"),
        ("flipped bits", Read(["b"], SAID), "read in part with a remark"),
        ("prefixes", Read(["b"], SAID), "WRONG, altered"),
        ("prefixes", Read(["a"], SAID), "read in part with a remark"),
        ("flipped bits", Read(["a", "b", "b"], SAID), "WRONG, altered"),
        ("flipped bits", Read(["a", "x"], SAID), "WRONG, altered"),
        ("flipped bits", Read(["a", "b"], frozenset()), "WRONG, unnoticed"),
        ("flipped bits", Read(["a"], frozenset()), "WRONG, altered and unnoticed"),
        ("flipped bits", Read(["a", "b"], SAID), "read whole with a remark"),
    ],
)
def test_what_is_wrong_is_called_wrong(damage: str, read: Read, verdict: str) -> None:
    assert judged(damage, read, SOUND) == verdict


def test_what_a_reader_lets_out_is_called_wrong() -> None:
    reads: list[object] = []

    def bad(path: object) -> Read:
        reads.append(path)
        if len(reads) > 1:
            raise KeyError("x")
        return SOUND

    ((place, verdict),) = sweep("prefixes", b"abc", bad, range(1, 2), 1)
    assert (place, verdict) == (1, "WRONG, KeyError: 'x'")
