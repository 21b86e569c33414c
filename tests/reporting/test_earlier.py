"""A report does not overwrite that of another evaluation."""

import pytest

from diffstack_mmv.reporting import require_same_drive, require_same_evaluation, write_json

HEADER = {
    "calibrated_on": None, "data": "thab_vru", "split": "val", "goal": "predicted", "seed": 1,
    "plans": True, "stride": 5, "solver": None, "ensemble": [], "steadiness": None,
    "checkpoint": "runs/1/best.ckpt", "checkpoint_sha256": "a", "code": "1",
}  # fmt: skip


def test_an_empty_folder_is_accepted(tmp_path):
    require_same_evaluation(tmp_path, HEADER)


@pytest.mark.parametrize(
    "changed",
    [
        {"code": "2"},
        {"ego_modes": ["bicycle"], "history_s": 4.0},
        {"checkpoint_sha256": "b"},
        {"checkpoint": "elsewhere/best.ckpt"},
    ],
    ids=["of other code", "of an earlier version", "trained on", "moved"],
)
def test_the_report_of_the_same_evaluation_may_be_replaced(tmp_path, changed):
    write_json(tmp_path / "metrics.json", HEADER)
    require_same_evaluation(tmp_path, HEADER | changed)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"split": "test"}, "another split than test, but got val"),
        ({"goal": "future"}, "another goal than future"),
        ({"steadiness": 0.5}, "another steadiness than 0.5, but got None"),
        ({"plans": False}, "another plans than False, but got True"),
        ({"stride": 9}, "another stride than 9"),
        ({"solver": {"max_iterations": 1}}, "another solver than {'max_iterations': 1}"),
        ({"ensemble": ["b.ckpt"]}, r"another ensemble than \['b.ckpt'\], but got \[\]"),
        ({"calibrated_on": "val"}, "another calibrated_on than val"),
        (
            {"checkpoint": "runs/2/best.ckpt", "checkpoint_sha256": "b"},
            "another checkpoint than runs/2/best.ckpt",
        ),
    ],
)
def test_another_evaluation_is_refused_with_what_differs_and_what_to_do(tmp_path, changed, told):
    write_json(tmp_path / "metrics.json", HEADER)
    with pytest.raises(ValueError, match=told) as refused:
        require_same_evaluation(tmp_path, HEADER | changed)
    assert "Give another out=FOLDER" in str(refused.value)


def test_the_report_of_a_drive_is_lost_to_no_other_controller(tmp_path):
    require_same_drive(tmp_path, "diffmpc")
    write_json(tmp_path / "closed_loop.json", {"controller": "diffmpc"})
    require_same_drive(tmp_path, "diffmpc")
    with pytest.raises(
        ValueError, match=r"another controller than mppi, but got diffmpc in .*out="
    ):
        require_same_drive(tmp_path, "mppi")
