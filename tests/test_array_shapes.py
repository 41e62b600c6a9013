"""Fields of arrays state type and shape, and every object that a test makes is held to that."""

import ast
import dataclasses
import importlib
from typing import NamedTuple

import numpy as np
import pytest
from array_shapes import WrongShape, check, stated, wrap_classes
from import_graph import modules, tree_of

from optim.geometry.polygons import pack
from optim.model.clearance import Separations
from optim.model.path import Samples, Segment, segment_from_states
from optim.model.problem import Problem
from optim.model.scene import Scene
from optim.numerics.arrays import Array, Float64, Int64, IntArray


def samples(n: int = 5) -> dict[str, np.ndarray]:
    zeros, whole = np.zeros(n), np.zeros(n, dtype=np.int64)
    return {"s": zeros, "states": np.zeros((n, 4)), "phi": zeros, "direction": whole, "segment": whole}


def test_arrays_as_stated_pass() -> None:
    assert Samples(**samples()).states.shape == (5, 4)
    assert len(pack([np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])]).vertices) == 3


@pytest.mark.parametrize(
    ("field", "wrong"),
    [
        ("states", np.zeros((5, 3))),
        ("states", np.zeros(5)),
        ("states", np.zeros((5, 4), dtype=np.float32)),
        ("phi", np.zeros(6)),  # another size than that of the other fields
        ("phi", [0.0] * 5),
        ("direction", np.zeros(5)),
    ],
)
def test_an_array_of_another_type_or_shape_is_refused(field: str, wrong: object) -> None:
    with pytest.raises(WrongShape, match=r"Samples\.(\w+) is .*, stated is"):
        Samples(**samples() | {field: wrong})  # pyright: ignore[reportArgumentType]


def test_a_dataclass_is_checked_once_it_has_been_made_of_what_it_was_given() -> None:
    segment = Segment(direction=1, **{name: [0.0, 1.0] for name in ("s", "x", "y", "theta", "alpha", "phi")})  # pyright: ignore
    assert segment.s.dtype == np.float64, "lists become arrays before the check"
    with pytest.raises(WrongShape, match=r"Scene\.polygons"):
        Scene(polygons=(np.zeros((4, 2)), np.zeros((3, 3))))
    with pytest.raises(WrongShape, match=r"Scene\.boundary"):
        dataclasses.replace(Scene(polygons=()), boundary=np.zeros((4, 2, 1)))


def test_a_field_that_may_be_missing_may_be_missing() -> None:
    states = np.zeros((2, 4))
    path = [segment_from_states(1, np.array([0.0, 1.0]), states, np.zeros(2))]
    problem = {"vehicle": None, "scene": Scene(polygons=()), "recorded": path}
    assert Problem(**problem, nodes=None).nodes is None  # pyright: ignore[reportArgumentType]
    assert Problem(**problem, nodes=np.zeros(3)).nodes is not None  # pyright: ignore[reportArgumentType]
    with pytest.raises(WrongShape, match=r"Problem\.nodes"):
        Problem(**problem, nodes=np.zeros((3, 1)))  # pyright: ignore[reportArgumentType]


class Steps(NamedTuple):
    """Sizes that follow from others."""

    lengths: Float64[Array, " n-1"]
    knots: Float64[Array, "n 2"]
    gears: Int64[IntArray, " n-1"]


def test_sizes_may_follow_from_others_whatever_the_order() -> None:
    gears = np.zeros(3, dtype=np.int64)
    check(Steps(np.zeros(3), np.zeros((4, 2)), gears))
    with pytest.raises(WrongShape, match=r"Steps\.lengths"):
        check(Steps(np.zeros(4), np.zeros((4, 2)), gears))


def test_wrapping_a_module_again_changes_nothing() -> None:
    module = importlib.import_module("optim.model.clearance")
    before = Separations.__new__
    wrap_classes(module)
    assert Separations.__new__ is before


def test_every_public_field_of_arrays_states_its_shape() -> None:
    missing = []
    for module in modules():
        if module.split(".")[0] != "optim" and module != "replay.run.case":
            continue
        classes = [node for node in tree_of(module).body if isinstance(node, ast.ClassDef)]
        for cls in (node for node in classes if not node.name.startswith("_")):
            for field in (node for node in cls.body if isinstance(node, ast.AnnAssign)):
                if "Array" in ast.unparse(field.annotation):
                    known = stated(getattr(importlib.import_module(module), cls.name))
                    name = ast.unparse(field.target)
                    missing += [] if name in known else [f"{module}.{cls.name}.{name}"]
    assert not missing, "\n".join(missing)
