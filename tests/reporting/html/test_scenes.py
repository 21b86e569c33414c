"""Scenes of two drives in one picture."""

import numpy as np
import pytest

from diffstack_mmv.reporting.html.scenes import GAP_M, Surroundings, driven_scene, side_by_side


def scene(steps, controls):
    """A drive of so many steps along x, with one line per step."""
    path = [[float(step), 0.0, 0.0] for step in range(steps)]
    return {
        "title": "a drive",
        "times": [0.25 * step for step in range(steps)],
        "start": 0,
        "goal": [5.0, 1.0],
        "bodies": [{"name": "robot", "role": "plan", "path": path, "shape": {"radius": 0.3}}],
        "lines": [{"role": "plan", "points": path}],
        "frames": [{
            "ellipses": [[1.0, 2.0, 0.1, 0.0, 0.1, 1.0]],
            "lines": [{"role": "intent", "points": path}],
        }] * steps,
        "series": [{"name": name, "values": [0.0] * steps} for name in controls],
    }  # fmt: skip


@pytest.mark.parametrize(("left", "right"), [(3, 5), (5, 3)])
def test_the_second_drive_lies_to_the_right_and_the_shorter_one_waits(left, right):
    both = side_by_side("both", scene(left, ["clearance"]), scene(right, ["clearance", "steer"]))
    shift = GAP_M + left - 1
    assert len(both["times"]) == len(both["frames"]) == 5
    assert both["goals"] == [[5.0, 1.0], [5.0 + shift, 1.0]]
    paths = [body["path"] for body in both["bodies"]]
    assert [path[0][0] for path in paths] == [0.0, shift]
    assert all(len(path) == 5 for path in paths)
    assert paths[0][-1][0] == left - 1
    assert both["frames"][0]["ellipses"][1][0] == 1.0 + shift
    assert len(both["frames"][4]["lines"]) == 1
    names = ["left: clearance", "right: clearance", "right: steer"]
    assert [series["name"] for series in both["series"]] == names
    assert all(len(series["values"]) == 5 for series in both["series"])


@pytest.mark.parametrize("told", [True, False], ids=["of the case", "of the settings"])
def test_goal_and_radii_of_a_drive_are_those_of_the_case_where_it_tells_them(told):
    arrays = {
        "steps": np.array([1]),
        "motion.position": np.zeros((1, 2, 2)),
        "motion.heading": np.zeros((1, 2)),
        "motion.velocity": np.zeros((1, 2, 2)),
        "pedestrians": np.ones((1, 2, 2, 2)),
        "controls": np.zeros((1, 1, 2)),
        "clearance": np.ones((1, 2)),
    }
    if told:
        arrays |= {"scene.goal": np.array([[3.0, 1.0]]), "scene.radius": np.array([[0.3, 0.5]])}
    shown = driven_scene("case 0", arrays, 0, Surroundings(0.25, 0.4, (0.0, 4.0), {}, ()))
    assert shown["goal"] == ([3.0, 1.0] if told else [0.0, 4.0])
    radii = [body["shape"]["radius"] for body in shown["bodies"] if body["role"] == "agent"]
    assert radii == ([0.3, 0.5] if told else [0.4, 0.4])
