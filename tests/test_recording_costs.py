"""The cost map and the points of methods that move points, in the recording."""

import pathlib

import numpy as np
import pytest
import recording_factory as factory
from recording_reading import Contents, written

from optim.model.problem import Problem
from optim.model.result import OnIterate, Picture, Result, Stop, ignore
from optim.model.scene import make_scene
from replay.recording.local import moved


class Pictured:
    """Gives back the recorded path and a picture of points."""

    def __init__(self, picture: Picture) -> None:
        self.picture = picture

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        del on_iterate
        return Result(path=problem.recorded, stop=Stop.CONVERGED, reason="", iterations=1, picture=self.picture)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (512_300.0, 5_412_400.0)])
def test_points_and_cost_map_are_drawn_where_they_are_also_far_from_the_origin(
    tmp_path: pathlib.Path, offset: tuple[float, float]
) -> None:
    places = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]) + offset
    costs = np.arange(12.0).reshape(3, 4)
    origin = (offset[0] - 1.0, offset[1] - 2.0)
    drawn = Picture(
        points=places, anchored=np.array([True, False, False]), cost_map=costs, origin=origin, resolution=0.5
    )
    near = factory.recorded_path()
    scene = make_scene([factory.box(20.0, 10.0, 3.0, 2.0) + np.array(offset)])
    run = factory.make_run({"cpo": Pictured(drawn)}, scene=scene, recorded=moved(near, -np.array(offset)))
    contents = Contents(written(run, tmp_path))
    shift = np.round(near.start[:2] / 100.0) * 100.0 if offset[0] else np.zeros(2)
    (held,) = contents.rows("/scene/cpo/cost/anchored", "Points2D:positions")
    (free,) = contents.rows("/scene/cpo/cost/moved", "Points2D:positions")
    np.testing.assert_allclose(held, [[1.0, 2.0] - shift])
    np.testing.assert_allclose(free, [[3.0, 4.0] - shift, [5.0, 6.0] - shift])
    ((corner,),) = contents.rows("/scene/cpo/cost/map", "Transform3D:translation")
    np.testing.assert_allclose(corner[:2], [-1.25, -2.25] - shift)


def test_of_the_cost_map_only_what_lies_on_the_map_is_drawn(tmp_path: pathlib.Path) -> None:
    costs = np.ones((400, 500))
    drawn = Picture(
        points=np.zeros((2, 2)), anchored=np.zeros(2, bool), cost_map=costs, origin=(-60.0, -20.0), resolution=0.25
    )
    run = factory.make_run({"cpo": Pictured(drawn)})
    boundary = run.case.problem.scene.boundary
    assert boundary is not None
    (x0, y0), (x1, y1) = boundary.min(axis=0), boundary.max(axis=0)
    contents = Contents(written(run, tmp_path))
    ((corner,),) = contents.rows("/scene/cpo/cost/map", "Transform3D:translation")
    ((format_,),) = contents.rows("/scene/cpo/cost/map", "Image:format")
    assert (corner[0], corner[1]) == pytest.approx((x0 - 0.125, y0 - 0.125))
    size = format_["width"], format_["height"]
    assert size == (round((x1 - x0) / 0.25) + 1, round((y1 - y0) / 0.25) + 1)
